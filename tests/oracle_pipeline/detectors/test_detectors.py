"""Single detectors against hand calculations, and their errors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.detectors import DetectorError
from oracle_pipeline.detectors.clusters import HacHeight
from oracle_pipeline.detectors.distances import LargestZ, Mahalanobis, NearestRuns

LINE = np.array([[0.0], [1.0], [2.0], [3.0]])


def normal_runs(n=60, features=3, seed=0):
    return np.random.default_rng(seed).normal(size=(n, features))


def test_max_z_is_the_largest_absolute_value():
    scores = LargestZ().fit(np.zeros((2, 3))).score_samples([[1.0, -4.0, 2.0], [0.0, 0.0, 0.5]])
    assert scores.tolist() == [-4.0, -0.5]


def test_mahalanobis_counts_common_deviations_once():
    rng = np.random.default_rng(0)
    common = rng.normal(scale=3.0, size=(4000, 1))
    detector = Mahalanobis().fit(np.hstack([common, common]) + rng.normal(size=(4000, 2)))
    along, across = detector.score_samples([[3.0, 3.0], [3.0, -3.0]])
    assert along == pytest.approx(-np.sqrt(9 * 2 / 19), rel=0.1)  # variances 19 and 1
    assert across == pytest.approx(-np.sqrt(9 * 2 / 1), rel=0.1)


@given(st.floats(1e-6, 1.0))
def test_mahalanobis_never_uses_a_variance_below_the_scale(spread):
    X = normal_runs(n=500) * [1.0, spread, 0.0]
    scores = Mahalanobis().fit(X).score_samples([[0.0, 4.0, 0.0], [0.0, 0.0, 4.0]])
    assert scores == pytest.approx([-4.0, -4.0], rel=0.15)


def test_nearest_runs_is_the_mean_distance_to_them():
    assert NearestRuns(n_neighbors=2).fit(LINE).score_samples([[5.0], [1.0]]) == pytest.approx(
        [-2.5, -0.5]
    )


def test_hac_height_is_where_the_run_joins_half_of_the_normal_ones():
    # Average linkage: 0-1 and 2-3 join at 1, the pairs at 2, then 9 at the mean of 9, 8, 7 and 6.
    assert HacHeight().fit(LINE).score_samples([[9.0]]) == pytest.approx([-7.5])


@pytest.mark.parametrize(
    ("detector", "rows", "text"),
    [
        (NearestRuns(n_neighbors=5), normal_runs(n=4), "4 runs are too few for 5 neighbours"),
        (LargestZ(), normal_runs(n=1), "at least two"),
    ],
)  # fmt: skip
def test_too_few_runs_are_an_error_with_the_number_needed(detector, rows, text):
    with pytest.raises(DetectorError, match=text):
        detector.fit(rows)


def test_values_that_are_not_finite_are_an_error():
    for detector in (LargestZ(), Mahalanobis(), HacHeight()):
        with pytest.raises(ValueError, match="NaN"):
            detector.fit([[np.nan], [1.0]])
