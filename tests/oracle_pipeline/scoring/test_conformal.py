import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from oracle_pipeline.scoring.conformal import (
    ConformalError,
    adjusted_for_suite,
    check_support,
    p_values,
    runs_needed,
)

# Few distinct values, so that ties are common.
scores = st.integers(1, 30).flatmap(
    lambda n: arrays(np.float64, n, elements=st.integers(-3, 3).map(float))
)


@given(scores, scores)
def test_a_p_value_counts_the_calibration_runs_with_at_least_the_score(calibration, new):
    counted = [(1 + (calibration >= s).sum()) / (len(calibration) + 1) for s in new]
    assert p_values(calibration, new).tolist() == counted


@given(scores, scores)
def test_p_values_do_not_increase_with_the_score(calibration, new):
    p = p_values(calibration, np.sort(new))
    assert (np.diff(p) <= 0).all()
    assert (p >= 1 / (len(calibration) + 1)).all()
    assert (p <= 1).all()


@pytest.mark.parametrize("n", [5, 19, 40])
def test_exchangeable_runs_have_super_uniform_p_values(n):
    rng = np.random.default_rng(n)
    draws = rng.integers(0, 30, size=(4000, n + 1)).astype(float)  # with ties
    p = np.array([p_values(each[1:], each[:1])[0] for each in draws])
    for alpha in (1 / (n + 1), 0.05, 0.1, 0.25, 0.5):
        excess = (p <= alpha).mean() - alpha
        assert excess < 3.3 * np.sqrt(alpha * (1 - alpha) / len(p))


@given(st.floats(1e-4, 0.999))
def test_the_runs_needed_are_just_enough(rate):
    n = runs_needed(rate)
    check_support(n, rate)
    if n:
        assert p_values(np.zeros(n), np.array([1.0]))[0] <= rate
        assert 1 / n > rate
        with pytest.raises(ConformalError, match=f"{n} are needed"):
            check_support(n - 1, rate)


@pytest.mark.parametrize(("rate", "runs"), [(0.05, 19), (0.01, 99), (0.1, 9), (1 / 49, 48)])
def test_runs_needed_for_usual_rates(rate, runs):
    assert runs_needed(rate) == runs


@pytest.mark.parametrize("rate", [0.0, 1.0, -0.1, np.nan])
def test_an_invalid_rate_is_an_error(rate):
    with pytest.raises(ConformalError, match="between 0 and 1"):
        runs_needed(rate)


def test_a_rate_that_the_calibration_cannot_support_is_an_error():
    new = np.array([9.0, 0.0])
    check_support(19, 0.05)
    assert (p_values(np.arange(19.0) / 19, new) <= 0.05).tolist() == [True, False]
    with pytest.raises(ConformalError, match="18 calibration runs cannot support"):
        check_support(18, 0.05)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_score_that_is_not_finite_is_an_error(bad):
    with pytest.raises(ConformalError, match="not a finite number"):
        p_values(np.array([0.0, bad]), np.array([1.0]))
    with pytest.raises(ConformalError, match="not a finite number"):
        p_values(np.zeros(3), np.array([bad]))


def test_a_suite_of_normal_runs_is_rarely_called_anomalous():
    rng = np.random.default_rng(0)
    accused = 0
    for _ in range(1000):
        p = p_values(rng.normal(size=99), rng.normal(size=20))
        accused += (adjusted_for_suite(p) <= 0.1).any()
    assert accused / 1000 < 0.1 + 3.3 * np.sqrt(0.09 / 1000)


def test_adjustment_equals_a_hand_calculation_and_leaves_single_runs_unchanged():
    assert adjusted_for_suite(np.array([0.03])).tolist() == [0.03]
    adjusted = adjusted_for_suite(np.array([0.01, 0.5, 0.02, 0.04]))
    assert adjusted == pytest.approx([0.04, 0.5, 0.04, 0.04 * 4 / 3])
