import numpy as np
import pytest

from oracle_pipeline.evaluation import integrity_checks as checks
from oracle_pipeline.evaluation.card_verdicts import card_folds, card_verdicts
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.splits import group_folds, without_hard_negatives
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, campaign
from tests.oracle_pipeline.evaluation.campaigns import synthetic

pytestmark = pytest.mark.slow

# As few modes as the checks of verdicts take.
FEW = {
    "lidar_passthrough": "normal",
    "lidar_passthrough_odom": "normal",
    "random_noise": "malicious",
    "benign_noise": "normal",
    "benign_obstacle": "normal",
}


def rng():
    return np.random.default_rng(0)


def scores_of(campaign, score):
    return HeldOutScores(np.asarray(score, dtype=float), np.asarray(score, dtype=float), 100)


def test_sessions_with_different_scores_are_red_and_one_session_is_unsupported():
    judged = synthetic(30)
    noise, session = rng().normal(size=len(judged.features)), judged.features["session"]
    alike = checks.same_between_sessions(scores_of(judged, noise), judged, rng())
    assert (alike.status, alike.figure.covers(0.5)) == ("green", True)
    different = checks.same_between_sessions(scores_of(judged, noise + 9 * session), judged, rng())
    assert (different.status, different.figure.value) == ("red", 1.0)


def in_sessions(blocks, session_of):
    """Return a campaign with other sessions, and without attacks in its features."""
    features, windows, truth = campaign(blocks)
    days = [table.assign(session=session_of(table["block"])) for table in (features, windows)]
    for table, original in zip(days, (features, windows), strict=True):
        table.attrs = original.attrs
    return JudgedRuns.of(*days, truth)


@pytest.mark.parametrize("session_of", [lambda block: block % 2, lambda block: block])
def test_sessions_are_compared_only_if_they_have_blocks_enough_to_differ(session_of):
    needed = checks.blocks_to_separate()
    for blocks in (2 * needed - 1, 2 * needed):
        judged = in_sessions(blocks, session_of)
        session = judged.features["session"].to_numpy()
        scores = scores_of(judged, rng().normal(size=len(session)) + 99.0 * session)
        check = checks.same_between_sessions(scores, judged, rng())
        can_fail = blocks == 2 * needed and len(set(session)) == 2
        assert check.status == ("red" if can_fail else "unsupported")
        assert can_fail or "could not fail with these runs" in check.sentence


@pytest.mark.parametrize(
    ("differences", "status"),
    [(None, "unsupported"), ([], "green"), (["random_noise|run000: node:/intruder"], "red")],
)
def test_the_graph_check_states_the_differences(differences, status):
    check = checks.equal_graphs(differences)
    assert check.status == status
    assert status != "red" or "/intruder" in check.sentence


def test_data_of_each_kind_turn_the_checks_of_verdicts_red():
    """A session that is unlike the others, and a hard negative that is unlike normal runs."""
    features, windows, truth = campaign(30, modes=FEW)
    for mark, name in (
        (lambda df: df["session"] == 2, "sessions_score_alike"),
        (lambda df: (df["mode"] == "benign_noise") & (df["block"] % 2 == 0), "hard_negatives_pass"),
    ):
        odd, clear = [], []
        for table in (features, windows):
            rows = np.flatnonzero(mark(table))
            scale = rng().uniform(20.0, 60.0, len(rows))
            worse = table.copy()
            for column, deviation in ATTACKED.items():
                worse.loc[rows, column] += scale * deviation
            worse.attrs = table.attrs
            odd.append(worse)
            clear.append(table)
        status = []
        for tables in (odd, clear):
            judged = JudgedRuns.of(*tables, truth)
            folds = (
                group_folds(judged.features, "session", 0)
                if name == "sessions_score_alike"
                else without_hard_negatives(judged.features, card_folds(judged.features, 0))
            )
            scores = card_verdicts(judged, folds).scores()
            check = {
                "sessions_score_alike": checks.same_between_sessions,
                "hard_negatives_pass": checks.hard_negatives,
            }[name](scores, judged, rng())
            status.append(check.status)
        assert status == ["red", "green"], name


def test_one_hard_negative_in_ten_may_be_called_anomalous():
    judged = synthetic(30)
    benign = judged.features["mode"].str.startswith("benign_").to_numpy()
    p = np.full(len(benign), 0.5)
    p[np.flatnonzero(benign)[:6]] = 0.01
    assert checks.hard_negatives(scores_of(judged, p), judged, rng()).status == "green"
    p[np.flatnonzero(benign)[:7]] = 0.01
    assert checks.hard_negatives(scores_of(judged, p), judged, rng()).status == "red"
    no_p = np.full(len(benign), np.nan)
    assert checks.hard_negatives(scores_of(judged, no_p), judged, rng()).status == "unsupported"


def test_hard_negatives_of_too_few_blocks_are_not_green_but_can_be_red():
    for blocks, status in ((28, "unsupported"), (29, "green")):
        judged = synthetic(blocks)
        right = scores_of(judged, np.full(len(judged.features), 0.5))
        assert checks.hard_negatives(right, judged, rng()).status == status
    few = synthetic(4)
    wrong = scores_of(few, np.full(len(few.features), 0.01))
    assert checks.hard_negatives(wrong, few, rng()).status == "red"
