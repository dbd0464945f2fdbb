"""The time of evidence is that of the change, as far as windows that overlap can tell."""

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.detectors import Deviation
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.evidence import farthest_features
from oracle_pipeline.scoring.run_scorer import NormalRange

SPEED = "contextual.speed"


NORMAL = NormalRange(0.8, 1.0, 1.2)


def span(values, z=9.0, normal=NORMAL):
    windows = pd.DataFrame({SPEED: values, "window_start_s": [2.5 * n for n in range(len(values))]})
    run = pd.DataFrame({SPEED: [3.0], "where": ["{}"]})
    deviation = Deviation(SPEED, z, False, 3.0, 1.0, 0.9, 1.1, "m/s")
    (found,) = farthest_features([deviation], FeatureTables(run, windows), {SPEED: normal})
    return found.window_start_s, found.window_end_s


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1.0, 1.1, 1.0, 3.0, 3.1, 2.9], (10.0, None)),  # new in the second half of 7.5 to 12.5 s
        ([1.0, 3.0, 3.1, 1.0, 1.2], (5.0, 10.0)),
        ([1.0, 1.0, 3.0, 1.0], (5.0, 10.0)),  # one window alone
        ([1.0, 1.0, 3.0], (7.5, None)),  # in the last window alone
        ([3.0, 3.1, 2.5], (0.0, None)),
        ([3.0, float("nan"), 3.1, 2.9], (7.5, None)),
        ([0.5, 0.9, 0.6], (None, None)),  # no window is higher than usual
        ([3.0, 3.0], (None, None)),
    ],
)
def test_evidence_lies_where_the_feature_is_at_least_half_as_far_as_at_most(values, expected):
    assert span(values) == expected
    mirrored = [2.0 - value for value in values]
    assert span(mirrored, z=-9.0) == expected


@pytest.mark.parametrize(
    ("values", "normal", "expected"),
    [
        ([2.0, 2.0, 4.0, 4.0], NormalRange(0.0, 1.0, 3.0), (7.5, None)),  # 2 is half as far
        ([2.0, 2.0, 3.0, 3.0], NormalRange(0.0, 1.0, 3.0), (None, None)),
        ([2.0, 2.0, 9.0, 9.0], NormalRange(-np.inf, 1.0, np.inf), (None, None)),
    ],
)
def test_evidence_does_not_lie_where_normal_windows_are_as_far(values, normal, expected):
    assert span(values, normal=normal) == expected
    mirrored = [2.0 - value for value in values]
    assert span(mirrored, -9.0, NormalRange(2.0 - normal.high, 1.0, 2.0 - normal.low)) == expected


def test_each_signal_is_told_by_its_farthest_statistic_and_by_one_that_windows_have():
    range_m, voltage = "signals./sonar/range", "signals./battery/voltage"
    ranked = [f"{range_m}.min", f"{range_m}.max", f"{range_m}.std", f"{range_m}.mean", SPEED,
              f"{voltage}.mean", f"{voltage}.std"]  # fmt: skip
    deviations = [Deviation(name, 9.0 - n, False, 3.0, 1.0, 0.9, 1.1, "m")
                  for n, name in enumerate(ranked)]  # fmt: skip
    windows = pd.DataFrame({
        "window_start_s": [0.0, 2.5], f"{range_m}.std": 1.0, f"{range_m}.mean": 1.0,
        f"{voltage}.mean": 1.0, f"{voltage}.std": 1.0,
    })  # fmt: skip
    run = pd.DataFrame({"where": ["{}"]})
    told = [each.feature for each in farthest_features(deviations, FeatureTables(run, windows))]
    assert told == [f"{range_m}.min", f"{range_m}.std", SPEED, f"{voltage}.mean"]
