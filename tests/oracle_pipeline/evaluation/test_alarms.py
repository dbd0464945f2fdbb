import numpy as np
import pytest

from oracle_pipeline.evaluation.alarms import (
    alarms_raised,
    judge_alarms,
    times_to_detect,
    window_p,
)
from oracle_pipeline.evaluation.comparisons import ComparedRuns
from oracle_pipeline.evaluation.splits import Fold
from tests.oracle_pipeline.evaluation.campaigns import by_hand

JUDGED = by_hand(
    ("delayed_fakeobject", 0, 40.0, 17.0, "[]"),  # windows end at 10, 15, ..., 40
    ("delayed_fakeobject", 1, 40.0, 17.0, "[]"),
    ("lidar_passthrough", 0, 40.0, 0.0, "[]"),
)


def alarms(*places):
    return np.isin(np.arange(21), places)


def test_detection_counts_from_the_onset_to_the_end_of_the_first_window_that_alarms():
    late = times_to_detect(alarms(0, 3, 4), JUDGED)  # at 10 s (too early), 25 s and 30 s
    assert late[:2].tolist() == [8.0, np.inf]
    assert np.isnan(late[2])


def test_neighbouring_alarms_are_one_and_do_not_run_from_run_to_run():
    assert alarms_raised(alarms(0, 1, 3, 6, 7), JUDGED).tolist() == [3, 1, 0]
    assert alarms_raised(alarms(), JUDGED).tolist() == [0, 0, 0]


def test_a_window_is_ranked_among_the_oddest_windows_of_calibration_runs():
    def mask(*rows):
        return np.isin(np.arange(3), rows)

    fold = Fold(mask(2), mask(1, 2), mask(0), mask(1, 2))
    scores = np.concatenate([np.arange(7.0), [9, 1, 1, 1, 1, 1, 1], [3, 1, 1, 1, 1, 1, 1]])[None]
    p = window_p(scores, JUDGED, [fold])
    assert p[:7].tolist() == pytest.approx([1, 1, 1, 1, 2 / 3, 2 / 3, 2 / 3])
    assert np.isnan(p[7:]).all()


def test_the_figures_of_alarms_by_hand():
    p = np.where(alarms(3, 15, 17), 0.01, 0.5)
    score = np.where(JUDGED.attacked_windows(), 1.0, 0.0)
    everything = ComparedRuns("all modes", np.ones(3, dtype=bool))
    row = judge_alarms(score, p, JUDGED, everything, np.random.default_rng(0))
    assert (row["attacked_windows"], row["normal_windows"], row["auc"]) == (10, 7, 1.0)
    assert (row["attacked_runs"], row["missed"]) == (2, 0.5)
    assert (row["time_to_detect_median_s"], row["time_to_detect_90_s"]) == (8.0, np.inf)
    assert row["false_alarms_per_h"] == pytest.approx(2 * 3600 / 40)
    assert row["false_alarms_per_h_low"] < 60 < 500 < row["false_alarms_per_h_high"]
