import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sklearn.base import clone

from oracle_pipeline.clustering.scaling import CLIP, FlooredRobustScaler

values = st.floats(-1e6, 1e6) | st.sampled_from([np.nan, np.inf, -np.inf])
tables = hnp.arrays(np.float64, st.tuples(st.integers(1, 12), st.integers(1, 4)), elements=values)


def frame(**columns):
    return pd.DataFrame({name: np.array(column, dtype=float) for name, column in columns.items()})


def scaled(table, **floors):
    return FlooredRobustScaler(floors).fit_transform(table)


@settings(max_examples=40)
@given(tables)
def test_scaled_features_are_finite_and_bounded_for_any_input(array):
    table = pd.DataFrame(array, columns=[f"f.{i}" for i in range(array.shape[1])])
    scaler = FlooredRobustScaler().fit(table)
    X = scaler.transform(table)
    assert X.shape == (len(table), len(scaler.kept_) + len(scaler.indicated_))
    assert np.isfinite(X).all()
    assert np.abs(X).max(initial=0.0) <= CLIP
    assert sorted(scaler.kept_ + scaler.dropped_) == sorted(table.columns)


@settings(max_examples=20)
@given(st.floats(0.01, 100.0), st.floats(-100.0, 100.0), st.integers(0, 99))
def test_the_unit_of_a_feature_does_not_matter(factor, offset, seed):
    x = np.random.default_rng(seed).normal(size=30)
    assert np.allclose(scaled(frame(x=x)), scaled(frame(x=factor * x + offset)), atol=1e-6)


def test_a_normal_column_gets_unit_deviation():
    x = np.random.default_rng(0).normal(7.0, 3.0, size=20_000)
    X = scaled(frame(x=x))
    assert np.std(X) == pytest.approx(1.0, abs=0.03)
    assert np.median(X) == 0.0


def test_a_constant_column_becomes_0_even_with_rounding_noise():
    noise = 0.1 + 1e-17 * np.arange(8) + np.array([0, 1, 2, 3] * 2) * 2.8e-17
    X = scaled(frame(constant=np.full(8, 4.2), noisy=noise, zero=np.zeros(8)))
    assert np.abs(X).max() < 1e-6


def test_one_outlier_in_a_constant_column_does_not_dominate_the_others():
    x = np.r_[np.zeros(99), 1.0]
    assert np.abs(scaled(frame(x=x))).max() <= CLIP
    assert scaled(frame(x=x), x=0.1).max() == pytest.approx(10.0)


def test_differences_below_the_declared_resolution_stay_below_one():
    x = np.random.default_rng(0).uniform(0.0, 0.9e-3, size=50)
    assert np.abs(scaled(frame(x=x), x=1e-3)).max() < 1.0


def test_missing_values_become_the_median_and_are_indicated():
    table = frame(whole=[1, 2, 3, 4], gappy=[np.nan, 2, 4, np.inf], empty=[np.nan] * 4)
    scaler = FlooredRobustScaler().fit(table)
    X = scaler.transform(table)
    assert (scaler.kept_, scaler.dropped_) == (["whole", "gappy"], ["empty"])
    assert scaler.indicated_ == ["gappy"]
    assert X[:, 1][[0, 3]].tolist() == [0.0, 0.0]
    assert X[:, 2].tolist() == [1.0, 0.0, 0.0, 1.0]


@given(hnp.arrays(np.float64, st.integers(1, 40), elements=values))
def test_centre_and_scale_are_median_and_mad_of_the_finite_values(column):
    finite = column[np.isfinite(column)]
    assume(len(finite))
    scaler = FlooredRobustScaler().fit(frame(x=column))
    mad = 1.4826 * np.median(np.abs(finite - np.median(finite)))
    assert scaler.center_ == pytest.approx([np.median(finite)], rel=1e-12)
    expected = max(mad, 0.1 * np.std(finite), 1e-9 * np.abs(finite).max())
    assert scaler.scale_ == pytest.approx([expected or 1.0], rel=1e-9)


def test_numbers_as_large_as_there_are_scale_to_bounded_ones():
    scaler = FlooredRobustScaler().fit(frame(x=[-1e308, 1e308, 1e308, -1e308], y=[1, 2, 3, 4]))
    X = scaler.transform(frame(x=[1.7e308, -1.7e308, np.inf, 0.0], y=[np.nan, 2.5, -np.inf, 1e308]))
    assert np.abs(X).max() <= CLIP
    assert X[2].tolist() == [0.0, 0.0]


def test_a_fitted_scaler_applies_to_other_runs():
    scaler = clone(FlooredRobustScaler({"x": 0.5})).fit(frame(x=[1, 2, 3]))
    assert scaler.transform(frame(x=[2])).tolist() == [[0.0]]
    assert scaler.center_.tolist() == [2.0]
