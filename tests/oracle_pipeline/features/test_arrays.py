import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import rankdata, spearmanr

from oracle_pipeline.features.statistics.arrays import (
    STATISTICS,
    doubled_ranks,
    each,
    roughness,
    standardised,
    statistics,
)


def of(numbers: list[float]) -> dict[str, float]:
    (row,) = statistics(np.array([numbers]))
    return dict(zip(STATISTICS, row, strict=True))


def test_statistics_of_an_array():
    found = of([1.0, 2.0, 3.0, 4.0, 4.0, np.inf, np.nan, 2.0])
    assert found["non_finite"] == 2 / 8
    assert found["at_limit"] == 3 / 6  # 1, 4 and 4
    assert found["distinct"] == 4 / 6
    # Bends around 2, 3 and 4: 0, 0 and 1 over 4.
    assert found["roughness"] == 0.0


def test_roughness_is_the_second_difference_over_the_number():
    numbers = np.array([[1.0, 2.0, 1.0, 2.0, 1.0], [5.0, 5.0, 5.0, 5.0, 5.0]])
    # Bends of 2 around 2, 1 and 2.
    assert roughness(numbers).tolist() == [1.0, 0.0]


def test_autocorrelation_distinguishes_a_slope_from_an_alternation():
    assert of(list(range(100)))["autocorrelation"] == pytest.approx(1.0, abs=0.02)
    assert of([1.0, -1.0] * 50)["autocorrelation"] == pytest.approx(-1.0)


@pytest.mark.parametrize("numbers", [[np.inf] * 20, [np.nan] * 20])
def test_non_finite_numbers_have_no_statistics(numbers):
    found = of(numbers)
    assert found.pop("non_finite") == 1.0
    assert np.isnan(list(found.values())).all()


rows = arrays(
    np.float64, st.tuples(st.integers(1, 4), st.integers(3, 12)),
    elements=st.floats(-100, 100, width=32) | st.sampled_from([0.0, np.inf, -np.inf, np.nan]),
)  # fmt: skip


@given(rows)
def test_statistics_keep_their_bounds(numbers):
    found = dict(zip(STATISTICS, statistics(numbers).T, strict=True))
    for name in ("non_finite", "at_limit", "distinct"):
        known = found[name][~np.isnan(found[name])]
        assert ((known >= 0.0) & (known <= 1.0)).all()
    assert not (np.abs(found["autocorrelation"]) > 1.0 + 1e-9).any()
    assert not (found["roughness"] < 0.0).any()


@given(rows, st.sampled_from([0.25, 2.0, 64.0]))
def test_statistics_have_no_unit(numbers, factor):
    np.testing.assert_allclose(statistics(factor * numbers), statistics(numbers), atol=1e-9)


@given(
    arrays(np.float64, 12, elements=st.integers(-5, 5)),
    arrays(np.float64, 12, elements=st.integers(-5, 5)),
)
def test_the_product_of_standard_ranks_is_spearmans_correlation(a, b):
    ranks = standardised(doubled_ranks(np.stack([a, b])))
    if np.ptp(a) and np.ptp(b):
        assert ranks[0] @ ranks[1] == pytest.approx(spearmanr(a, b).statistic)
    else:
        assert ranks[0] @ ranks[1] == 0.0


def test_arrays_of_any_lengths_keep_their_order():
    ragged = [np.full(length, number) for number, length in enumerate([3, 1, 3, 2, 1])]
    values = np.fromiter(ragged, dtype=object, count=5)
    assert each(lambda same: same.mean(axis=1), values) == [0, 1, 2, 3, 4]
    assert each(lambda same: same.sum(axis=1), values) == [0, 1, 6, 6, 4]


@given(
    arrays(
        np.float64, st.tuples(st.integers(1, 4), st.integers(1, 30)),
        elements=st.sampled_from([-1.0, 0.0, 0.5, 1.0, np.inf]),
    )
)  # fmt: skip
def test_ranks_are_those_of_scipy(values):
    assert (doubled_ranks(values) / 2.0 == rankdata(values, axis=1)).all()
