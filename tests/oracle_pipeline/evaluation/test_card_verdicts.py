"""The evaluation's verdicts are those of `oracle score`, by cards that do not know the run."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from oracle_pipeline.evaluation.card_verdicts import blocks_for_verdicts, card_folds, card_verdicts
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.judging import Recording, judge, judge_all
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.output import exit_code
from oracle_pipeline.scoring.reference import Reference
from tests.oracle_pipeline.evaluation.campaigns import synthetic

RIGHT = Observation({"/scan": ("sensor_msgs/msg/LaserScan", (), 5.0)}, frozenset({"node:/a"}))
WRONG = replace(RIGHT, graph=frozenset({"node:/a", "node:/intruder"}))

FEW = {"lidar_passthrough": "normal", "random_noise": "malicious", "benign_noise": "normal"}


@pytest.fixture(scope="module")
def campaign():
    return synthetic(24, effect=2.0, modes=FEW)


@pytest.fixture(scope="module")
def judged(campaign):
    return card_verdicts(campaign, card_folds(campaign.features, 0))


def test_judging_in_other_processes_changes_no_verdict(campaign, judged):
    def sent(what):
        return pickle.loads(pickle.dumps(what))  # noqa: S301 -- our own bytes

    def elsewhere(function, folds):
        return [sent(sent(function)(fold)) for fold in folds]

    again = card_verdicts(campaign, card_folds(campaign.features, 0), each=elsewhere)
    assert again.verdicts == judged.verdicts


def row_of(runs, row):
    return FeatureTables(runs.features.iloc[[row]], runs.windows[runs.run == row])


def test_runs_judged_at_once_get_the_verdicts_of_judging_each(campaign):
    normal = ~campaign.malicious & (campaign.block < 22)  # runs of known and of other blocks
    known = campaign.where(normal)
    seen = tuple(RIGHT for _ in known.features["run_id"])
    card = learn(Reference(known.features, known.windows, seen))
    observations = dict.fromkeys(campaign.features["run_id"][::2], WRONG)
    names = [str(run) for run in campaign.features["run_id"]]
    recordings = [
        Recording(run, row_of(campaign, row), observations.get(run))
        for row, run in enumerate(names)
    ]
    at_once = judge_all(recordings, card, 0.05)
    for row in range(0, len(at_once), 9):
        recording = recordings[row]
        alone = judge(recording.name, recording.tables, card, 0.05, recording.seen)
        assert (each := at_once[row]).score == pytest.approx(alone.score)
        for name, aspect in alone.aspects.items():
            assert each.aspects[name].score == pytest.approx(aspect.score)
            assert each.aspects[name].p_value == aspect.p_value
        assert [a.time_s for a in each.alarms] == [a.time_s for a in alone.alarms]
        for name in ("outcome", "contract", "p_value", "alarms_per_h", "normal_runs"):
            assert getattr(each, name) == getattr(alone, name)
    assert {verdict.outcome for verdict in at_once} == {"normal", "breach", "anomalous"}


def test_no_card_has_seen_the_block_of_a_run_that_it_judges(campaign, judged):
    folds = card_folds(campaign.features, 0)
    fold = folds[1]
    odd = campaign.features.copy()
    first = np.flatnonzero(fold.test)[0]
    odd.loc[first, ["structural.entropy", "contextual.yaw_variance"]] = 1e6
    again = card_verdicts(replace(campaign, features=odd), [fold])
    others = [row for row in np.flatnonzero(fold.test) if row != first]
    assert all(again.verdicts[row] == judged.verdicts[row] for row in others)
    for each in folds:
        learned = set(campaign.block[each.fit | each.calibrate])
        assert learned.isdisjoint(campaign.block[each.test])


def test_the_exit_code_is_that_of_the_command(campaign, judged):
    exits = judged.exits()
    for row, verdict in enumerate(judged.verdicts):
        assert exits[row] == exit_code([verdict])
    p = judged.scores().p
    assert np.array_equal(exits == 1.0, p <= 0.05)  # without a contract


def test_a_breach_alone_gives_exit_code_1_and_no_contract_is_learned_from_some_runs(campaign):
    runs = campaign.features["run_id"].tolist()
    intruded = dict.fromkeys(runs, RIGHT) | {"lidar_passthrough|run003": WRONG}
    row = runs.index("lidar_passthrough|run003")
    tested = next(fold for fold in card_folds(campaign.features, 0) if fold.test[row])
    found = card_verdicts(campaign, [tested], intruded)
    assert found.verdicts[row].contract == ("Node /intruder is new.",)
    assert found.exits()[row] == 1.0
    learned_from = runs[np.flatnonzero(tested.fit)[0]]
    some = {run: seen for run, seen in intruded.items() if run != learned_from}
    assert card_verdicts(campaign, [tested], some).verdicts[row].contract == ()


def test_five_sessions_are_held_out_whole_and_few_blocks_share_one_card():
    days = synthetic(24)
    features = days.features.assign(session=days.block // 4)
    for fold in card_folds(features, 0):
        known = set(features.loc[fold.fit | fold.calibrate, "session"])
        assert known.isdisjoint(features.loc[fold.test, "session"])
    few = synthetic(3)
    (fold,) = card_folds(few.features, 0)
    assert fold.test.all()
    verdicts = card_verdicts(few, [fold])
    assert np.isfinite(verdicts.scores().score).all()
    assert verdicts.scores().calibration == 2  # the own block has no vote
    assert np.isnan(verdicts.exits()).all()


def test_two_blocks_give_no_verdict():
    few = synthetic(2)
    verdicts = card_verdicts(few, card_folds(few.features, 0))
    assert set(verdicts.verdicts) == {None}
    assert np.isnan(verdicts.scores().score).all()
    assert verdicts.scores("tampering").calibration == 0


def test_verdicts_take_blocks_enough_when_a_fifth_is_held_out(judged):
    assert blocks_for_verdicts() == 24
    assert judged.scores().calibration == 19
    assert np.isfinite(judged.exits()).all()
