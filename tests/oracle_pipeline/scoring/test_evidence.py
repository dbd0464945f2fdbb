"""The time of evidence is that of the change, as far as windows that overlap can tell."""

import pandas as pd
import pytest

from oracle_pipeline.detectors import Deviation
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.evidence import farthest_features

SPEED = "contextual.speed"


def span(values, z=9.0, usual=1.0):
    windows = pd.DataFrame({SPEED: values, "window_start_s": [2.5 * n for n in range(len(values))]})
    run = pd.DataFrame({SPEED: [3.0], "where": ["{}"]})
    deviation = Deviation(SPEED, z, False, 3.0, 1.0, 0.9, 1.1, "m/s")
    (found,) = farthest_features([deviation], FeatureTables(run, windows), {SPEED: usual})
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
