from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.detectors import panel
from oracle_pipeline.evaluation import integrity_checks as checks
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.splits import block_folds
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, campaign
from tests.oracle_pipeline.evaluation.campaigns import synthetic

pytestmark = pytest.mark.slow

COLUMNS = list(ATTACKED)


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
def test_sessions_are_compared_only_with_enough_blocks(session_of):
    needed = checks.blocks_to_separate()
    for blocks, status in ((2 * needed - 1, "unsupported"), (2 * needed, "red")):
        judged = in_sessions(blocks, session_of)
        session = judged.features["session"].to_numpy()
        later = session > np.median(session)  # the other one of two, or the later half
        scores = scores_of(judged, rng().normal(size=len(later)) + 99.0 * later)
        check = checks.same_between_sessions(scores, judged, rng())
        assert check.status == status
        assert status == "red" or f"needs {needed} blocks in each" in check.sentence
        label = checks.label_above_session(judged, COLUMNS, block_folds(judged.features, 0), 0)
        assert (label.status == "unsupported") == (status == "unsupported")


def test_sessions_of_one_block_with_similar_scores_are_green():
    judged = in_sessions(30, lambda block: block)
    noise = rng().normal(size=len(judged.features))
    check = checks.same_between_sessions(scores_of(judged, noise), judged, rng())
    assert (check.status, "earlier sessions and later sessions" in check.sentence) == (
        "green",
        True,
    )


@pytest.mark.parametrize(
    ("differences", "status"),
    [(None, "unsupported"), ([], "green"), (["random_noise|run000: node:/intruder"], "red")],
)
def test_the_graph_check_states_the_differences(differences, status):
    check = checks.equal_graphs(differences)
    assert check.status == status
    assert status != "red" or "/intruder" in check.sentence


def test_a_session_that_is_as_predictable_as_the_label_is_red(monkeypatch):
    monkeypatch.setattr(checks, "TREES", 15)
    features, windows, truth = campaign(24, effect=12.0)
    judged = JudgedRuns.of(features, windows, truth)
    folds = block_folds(judged.features, 0)
    check = checks.label_above_session(judged, COLUMNS, folds, 0)
    assert (check.status, check.figure.value < 0.75) == ("green", True)
    marked = features.assign(**{"structural.density": features["session"] + 0.0})
    confounded = JudgedRuns.of(marked, windows, truth)
    columns = [*COLUMNS, "structural.density"]
    check = checks.label_above_session(confounded, columns, folds, 0)
    assert (check.status, check.figure.value > 0.95) == ("red", True)
    assert checks.label_above_session(judged, COLUMNS, [], 0).status == "unsupported"


def test_shuffled_labels_are_chance_unless_a_label_leaks(monkeypatch):
    monkeypatch.setattr(checks, "SHUFFLES", 25)
    judged, detector = synthetic(9, effect=8.0), panel(0)["max_z"]
    check = checks.shuffled_labels(judged, COLUMNS, detector, block_folds, rng())
    assert check.status == "green"
    assert check.figure.low <= 0.5 <= check.figure.high

    def leaky(df, seed):
        """Folds whose training runs are those tested: only normal ones are fitted on."""
        right = (df["label"] != "malicious").to_numpy()
        whole = np.ones(len(df), dtype=bool)
        return [replace(f, fit=right, calibrate=right, test=whole) for f in block_folds(df, seed)]

    knn = panel(0)["knn"].set_params(n_neighbors=1)
    leaked = checks.shuffled_labels(judged, COLUMNS, knn, leaky, rng())
    assert (leaked.status, leaked.figure.value > 0.9) == ("red", True)


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


def test_a_shortcut_in_the_headline_is_red_and_an_undeclared_feature_unsupported():
    features, _, _ = campaign(3)
    assert checks.shortcuts_are_separate(features, COLUMNS, NOTHING).status == "green"
    fields = features.attrs["fields"]
    features.attrs["fields"] = fields | {COLUMNS[0]: {"shortcut": "true"}}
    check = checks.shortcuts_are_separate(features, COLUMNS, Estimate(1.0, 0.9, 1.0))
    assert (check.status, COLUMNS[0] in check.sentence) == ("red", True)
    features.attrs["fields"] = {}
    assert checks.shortcuts_are_separate(features, COLUMNS, NOTHING).status == "unsupported"


def test_the_banner_has_all_checks_that_are_not_green():
    green = checks.equal_graphs([])
    unknown = checks.equal_graphs(None)
    assert checks.banner([green, green]) == ""
    assert checks.banner([green, unknown]).startswith("graphs_of_pairs_are_equal is unsupported")
    assert set(pd.DataFrame([green.columns()])) == {
        "name", "status", "sentence", "figure", "figure_low", "figure_high"
    }  # fmt: skip
