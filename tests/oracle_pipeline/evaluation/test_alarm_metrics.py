import numpy as np
import pytest

from oracle_pipeline.evaluation.alarm_metrics import (
    WatchedRuns,
    judge_alarms,
    times_to_detect,
    watched,
)
from oracle_pipeline.evaluation.comparisons import ComparedRuns
from oracle_pipeline.evaluation.reference_scores import reference_of
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.judging import judge
from oracle_pipeline.scoring.learning import Cards
from oracle_pipeline.scoring.reference import Reference
from tests.oracle_pipeline.evaluation.campaigns import by_hand, synthetic

JUDGED = by_hand(
    ("delayed_fakeobject", 0, 40.0, 17.0, "[]"),  # windows end at 5, 7.5, ..., 40
    ("delayed_fakeobject", 1, 40.0, 17.0, "[]"),
    ("lidar_passthrough", 0, 40.0, 0.0, "[]"),
)


def alarms(*places):
    return np.isin(np.arange(45), places)


def raised_in(runs):
    return watched(runs, reference_of(runs, ~runs.malicious))


def test_time_to_detect_is_from_onset_to_the_end_of_the_first_window_with_an_alarm():
    late = times_to_detect(alarms(0, 8, 9), JUDGED, JUDGED.onset_s)  # at 5 s: too early
    assert late[:2].tolist() == [8.0, np.inf]
    assert np.isnan(late[2])


def test_an_attack_takes_effect_when_it_first_changes_a_message():
    judged = by_hand(
        ("fake_object", 0, 40.0, 3.0, "[[20.0, 3, 0.5], [30.0, 1, 0.5]]"),
        ("fake_object", 1, 40.0, 3.0, "[[0.0, 3, 0.5]]"),
        ("fake_object", 2, 40.0, 3.0, "[]"),
    )
    assert judged.effect_s.tolist() == [20.0, 3.0, 3.0]
    late = times_to_detect(np.isin(judged.place, (10,)), judged, judged.effect_s)
    assert late.tolist() == [10.0, 27.0, 27.0]  # that window ends at 30 s


def test_alarm_metrics_equal_a_hand_calculation():
    raised = WatchedRuns(
        np.where(JUDGED.attacked_windows(), 1.0, 0.0), alarms(8, 33, 35), per_hour=0.5
    )
    everything = ComparedRuns("all modes", np.ones(3, dtype=bool))
    row = judge_alarms(raised, JUDGED, everything, np.random.default_rng(0))
    assert (row["attacked_windows"], row["normal_windows"], row["auc"]) == (20, 15, 1.0)
    assert (row["attacked_runs"], row["normal_runs"], row["missed"]) == (2, 1, 0.5)
    assert (row["time_to_detect_median_s"], row["time_to_detect_90_s"]) == (8.0, np.inf)
    assert row["after_effect_median_s"] == 8.0
    assert row["promised_per_h"] == 0.5
    assert row["false_alarms_per_h"] == pytest.approx(2 * 3600 / 40)
    assert row["false_alarms_per_h_low"] < 60 < 500 < row["false_alarms_per_h_high"]


def test_false_alarms_keep_the_promised_rate_and_planted_attacks_are_detected():
    planted = synthetic(20, effect=15.0)
    raised = raised_in(planted)
    assert 0.5 < raised.per_hour < 3.0  # too few hours for the usual rate
    row = judge_alarms(
        raised, planted, ComparedRuns("all", np.ones(len(planted.features), dtype=bool)),
        np.random.default_rng(0),
    )  # fmt: skip
    assert row["false_alarms_per_h"] <= row["promised_per_h"]
    assert row["missed"] < 0.05
    assert row["auc"] > 0.95


def test_oracle_score_raises_the_alarms_of_the_evaluation():
    planted = synthetic(8, effect=15.0)
    raised = raised_in(planted)
    cards = Cards(Reference(planted.features, planted.windows))
    for row in range(0, len(planted.features), 7):
        of_run = planted.run == row
        tables = FeatureTables(planted.features.iloc[[row]], planted.windows[of_run])
        verdict = judge("run", tables, cards.card_for(tables.run), 0.5)
        expected = planted.end_s[of_run & raised.alarm]
        # The end of the last window is not in the tables: it may be cut off.
        assert [alarm.time_s for alarm in verdict.alarms] == pytest.approx(expected, abs=5.0)


def test_two_blocks_are_too_few_for_alarms():
    raised = raised_in(synthetic(2))
    assert np.isnan(raised.score).all()
    assert np.isnan(raised.per_hour)
    assert not raised.alarm.any()
