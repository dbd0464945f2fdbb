import numpy as np
import pytest

from oracle_pipeline.evaluation.alarm_metrics import judge_alarms, times_to_detect
from oracle_pipeline.evaluation.card_verdicts import CardVerdicts, card_folds, card_verdicts
from oracle_pipeline.evaluation.comparisons import ComparedRuns
from oracle_pipeline.scoring.alarms import Alarm
from oracle_pipeline.scoring.verdict import Verdict
from tests.oracle_pipeline.evaluation.campaigns import by_hand, synthetic

JUDGED = by_hand(
    ("delayed_fakeobject", 0, 40.0, 17.0, "[]"),
    ("delayed_fakeobject", 1, 40.0, 17.0, "[]"),
    ("lidar_passthrough", 0, 40.0, 0.0, "[]"),
)


def raising(*times_s, runs=20):
    alarms = tuple(Alarm(time_s, 2.0, 1.0) for time_s in times_s)
    return Verdict("run", "normal", alarms=alarms, alarms_per_h=0.5, normal_runs=runs)


def everything(campaign):
    return ComparedRuns("all modes", np.ones(len(campaign.features), dtype=bool))


def test_time_to_detect_is_from_onset_to_the_end_of_the_first_window_with_an_alarm():
    verdicts = CardVerdicts((raising(5.0, 25.0, 27.5), raising(5.0), raising(10.0)))
    late = times_to_detect(verdicts, JUDGED, JUDGED.onset_s)  # 5 s is too early
    assert late[:2].tolist() == [8.0, np.inf]
    assert np.isnan(late[2])
    barely = CardVerdicts((raising(17.2), raising(17.3), raising()))  # of windows from 12.2 s on
    assert times_to_detect(barely, JUDGED, JUDGED.onset_s)[:2].tolist() == [
        np.inf,
        pytest.approx(0.3),
    ]


def test_an_attack_takes_effect_when_it_first_changes_a_message():
    judged = by_hand(
        ("fake_object", 0, 40.0, 3.0, "[[20.0, 3, 0.5], [30.0, 1, 0.5]]"),
        ("fake_object", 1, 40.0, 3.0, "[[0.0, 3, 0.5]]"),
        ("fake_object", 2, 40.0, 3.0, "[]"),
    )
    assert judged.effect_s.tolist() == [20.0, 3.0, 3.0]
    late = times_to_detect(CardVerdicts((raising(30.0),) * 3), judged, judged.effect_s)
    assert late.tolist() == [10.0, 27.0, 27.0]


def test_alarm_metrics_equal_a_hand_calculation():
    verdicts = CardVerdicts((raising(25.0), raising(), raising(12.0, 22.0, runs=19)))
    row = judge_alarms(verdicts, JUDGED, everything(JUDGED), np.random.default_rng(0))
    assert (row["attacked_runs"], row["normal_runs"], row["missed"]) == (2, 1, 0.5)
    assert (row["time_to_detect_median_s"], row["time_to_detect_90_s"]) == (8.0, np.inf)
    assert row["after_effect_median_s"] == 8.0
    assert (row["promised_per_h"], row["behind_promise"]) == (0.5, 19)
    assert row["false_alarms_per_h"] == pytest.approx(2 * 3600 / 40)
    assert row["false_alarms_per_h_low"] < 60 < 500 < row["false_alarms_per_h_high"]


def test_false_alarms_keep_the_promised_rate_and_planted_attacks_are_detected():
    planted = synthetic(24, effect=15.0)
    verdicts = card_verdicts(planted, card_folds(planted.features, 0))
    row = judge_alarms(verdicts, planted, everything(planted), np.random.default_rng(0))
    assert 0.5 < row["promised_per_h"] < 3.0  # too few hours for the usual rate
    assert row["behind_promise"] == 19 * 8
    assert row["false_alarms_per_h_low"] <= row["promised_per_h"]
    assert row["missed"] < 0.05


def test_without_verdicts_there_are_no_alarms():
    few = synthetic(2)
    nothing = CardVerdicts((None,) * len(few.features))
    row = judge_alarms(nothing, few, everything(few), np.random.default_rng(0))
    assert (row["attacked_runs"], row["normal_runs"], row["behind_promise"]) == (0, 0, 0)
    assert np.isnan([row["promised_per_h"], row["false_alarms_per_h"]]).all()
