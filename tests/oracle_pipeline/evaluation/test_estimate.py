import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from oracle_pipeline.evaluation.estimate import NOTHING, Estimate, clopper_pearson, newcombe_auc


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_every_format_prints_the_interval(value, low, high):
    area = Estimate(value, low, high)
    for text in (str(area), f"{area}", f"{area:.3f}", "{}".format(area), repr(area)):  # noqa: UP032
        digits = "3f" if text == f"{area:.3f}" else "2f"
        shown = (
            [value, low, high] if text == repr(area) else [f"{x:.{digits}}" for x in (low, high)]
        )
        assert all(str(part) in text for part in shown)


def test_an_empty_estimate_prints_as_such_and_covers_nothing():
    assert str(NOTHING) == "n/a"
    assert not NOTHING.covers(0.5)


@given(st.integers(1, 60).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_clopper_pearson_is_the_exact_interval(counts):
    hits, n = counts
    expected = binomtest(hits, n).proportion_ci(method="exact")
    rate = clopper_pearson(hits / n, n)
    assert (rate.low, rate.high) == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_clopper_pearson_widens_with_fewer_runs_and_needs_at_least_one():
    few, many = clopper_pearson(0.953, 45), clopper_pearson(0.953, 1000)
    assert few.low < many.low < 0.953 < many.high < few.high
    assert clopper_pearson(np.nan, 0) == NOTHING


@given(st.floats(0.0, 1.0), st.integers(1, 60), st.integers(1, 60))
def test_newcombe_contains_the_value_and_is_symmetric(value, m, n):
    area, mirrored = newcombe_auc(value, m, n), newcombe_auc(1.0 - value, m, n)
    assert 0.0 <= area.low <= value <= area.high <= 1.0
    assert (area.low, area.high) == pytest.approx((1 - mirrored.high, 1 - mirrored.low), abs=2e-4)


def test_newcombe_has_a_wide_interval_for_few_perfectly_separated_runs():
    assert newcombe_auc(1.0, 3, 3).low < 0.6
    assert newcombe_auc(1.0, 15, 15).low > 0.7
