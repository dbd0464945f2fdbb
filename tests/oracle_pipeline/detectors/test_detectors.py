"""Single detectors against hand calculations, and their errors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.detectors import DetectorError
from oracle_pipeline.detectors.distances import LargestZ, Mahalanobis


def normal_runs(n=60, features=3, seed=0):
    return np.random.default_rng(seed).normal(size=(n, features))


def test_the_score_of_one_feature_is_the_largest_absolute_value():
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


def test_a_single_run_is_an_error_with_the_number_needed():
    with pytest.raises(DetectorError, match="at least two"):
        LargestZ().fit(normal_runs(n=1))


def test_values_that_are_not_finite_are_an_error():
    for detector in (LargestZ(), Mahalanobis()):
        with pytest.raises(ValueError, match="NaN"):
            detector.fit([[np.nan], [1.0]])
