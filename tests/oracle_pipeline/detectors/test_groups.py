"""One clear topic is never diluted by a hundred quiet ones."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.covariance import ledoit_wolf, ledoit_wolf_shrinkage

from oracle_pipeline.detectors import LargestGroup, SignalScaler
from oracle_pipeline.detectors.base import shrinkage
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.signals.collector import Signals
from oracle_pipeline.features.signals.statistics import SignalTable

TOPICS = 100
GROUPS = [f"/{topic}" for topic in range(TOPICS) for _ in range(3)]


def test_change_in_one_of_a_hundred_topics_stands_out():
    rng = np.random.default_rng(0)
    normal, new = rng.normal(size=(20, 3 * TOPICS)), rng.normal(size=(2, 3 * TOPICS))
    new[1, 30:33] += 12.0
    detector = LargestGroup(GROUPS).fit(normal)
    unchanged, changed = -detector.score_samples(new)
    assert changed > 2.0 * unchanged


@pytest.mark.parametrize(("directions", "stands_out"), [(12, False), (50, True)])
def test_more_recordings_show_more_of_what_belongs_together(directions, stands_out):
    rng = np.random.default_rng(0)
    one, noise = rng.normal(size=(201, 25)), 0.05 * rng.normal(size=(201, 25))
    both = np.hstack([one, one + noise])
    both[200, 30] += 2.0  # as often seen as not, but never beside what column 5 has
    detector = LargestGroup(directions=directions).fit(both[:200])
    distances = -detector.score_samples(both)
    assert (distances[200] > distances[:200].max()) is np.bool_(stands_out)


def rows_of(rows, columns, rank, seed):
    """Return centred rows, in so many independent directions at most."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns))
    return X - X.mean(axis=0)


@given(st.integers(2, 40), st.integers(1, 60), st.integers(1, 60), st.integers(0, 99))
def test_the_share_of_the_target_is_that_of_scikit_learn(rows, columns, rank, seed):
    X = rows_of(rows, columns, rank, seed)
    covariance = X.T @ X / rows
    found = shrinkage(X, np.trace(covariance), (covariance**2).sum())
    assert found == pytest.approx(ledoit_wolf_shrinkage(X, assume_centered=True), abs=1e-9)


@given(st.integers(2, 40), st.integers(1, 60), st.integers(1, 60), st.integers(0, 99))
def test_directions_are_at_right_angles_also_if_columns_depend_on_others(rows, columns, rank, seed):
    detector = LargestGroup().fit(100.0 * rows_of(rows, columns, rank, seed))
    (directions,) = detector.components_
    products = directions @ directions.T
    lengths = np.diag(products)
    assert np.all((np.abs(lengths - 1.0) < 1e-5) | (lengths == 0.0))
    assert np.abs(products - np.diag(lengths)).max() < 1e-5


@given(st.integers(3, 40), st.integers(1, 12), st.integers(1, 12), st.integers(0, 99))
def test_of_few_columns_the_whole_covariance_counts(rows, columns, rank, seed):
    X = rows_of(rows, columns, rank, seed)
    covariance, share = ledoit_wolf(X, assume_centered=True)
    variances, directions = np.linalg.eigh(covariance)
    least = max(0.05, share * np.trace(X.T @ X / rows) / columns)
    everywhere = np.vstack([X, np.random.default_rng(seed).normal(size=(9, columns))])
    squared = ((everywhere @ directions) ** 2 / np.maximum(variances, least)).sum(axis=1)
    expected = np.sqrt(squared) / max(np.median(np.sqrt(squared[:rows])), 1.0)
    found = -LargestGroup().fit(X).score_samples(everywhere)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_scale_is_not_that_of_the_unchanging_majority():
    column = np.array([0.0] * 15 + [1.0] * 5)
    scaler = SignalScaler({}).fit(pd.DataFrame({"a": column}))
    assert abs(scaler.transform(pd.DataFrame({"a": [1.0]}))[0, 0]) < 5.0


@pytest.mark.parametrize("changed_before", [0, 1])
def test_change_of_what_seldom_changes_counts_but_not_for_all(changed_before):
    seldom = np.ones(20)
    seldom[:changed_before] += 1e-4
    scaler = SignalScaler({}).fit(pd.DataFrame({"a": seldom, "b": np.arange(20.0)}))
    changed = scaler.transform(pd.DataFrame({"a": [7.0], "b": [1e6]}))[0]
    assert changed == pytest.approx([5.0, 50.0])


def test_a_small_change_of_what_is_always_zero_counts_as_that_of_any_constant():
    scaler = SignalScaler({}).fit(pd.DataFrame({"error": np.zeros(20), "noise": np.zeros(20)}))
    changed = scaler.transform(pd.DataFrame({"error": [0.02], "noise": [1e-12]}))[0]
    assert changed == pytest.approx([5.0, 0.0], abs=1e-3)


@pytest.mark.parametrize(("spread", "far"), [(1.0, 13.0), (0.0, 5.0)])
def test_a_signal_that_changes_and_then_stands_still_is_far_and_a_flag_that_is_set_is_not(
    spread, far
):
    normal = pd.DataFrame({"mag.std": np.full(20, spread), "mag.held": np.full(20, 0.004)})
    scaler = SignalScaler({"mag.held": 0.05}).fit(normal)
    stuck = scaler.transform(pd.DataFrame({"mag.std": [spread], "mag.held": [0.654]}))[0]
    assert stuck == pytest.approx([0.0, far])


def test_lost_messages_of_a_simulator_are_not_far_and_a_silence_is():
    normal = statistics_of_periods([np.full(200, 0.05)] * 20)
    scaler = SignalScaler({}).fit(normal)
    detector = LargestGroup().fit(scaler.transform(normal))
    lost, silent = np.full(195, 0.05), np.full(200, 0.05)
    lost[::40], silent[100] = 0.1, 5.0
    lost, silent = (scaler.transform(statistics_of_periods([each])) for each in (lost, silent))
    assert -detector.score_samples(lost) < 1.5 < 10.0 < -detector.score_samples(silent)


def statistics_of_periods(recordings):
    rows = []
    for periods in recordings:
        times_ns = np.rint(np.cumsum(periods) * 1e9).astype(np.int64)
        table = SignalTable([Signals("/imu", ("period",), ("s",), times_ns, periods[:, None])])
        rows.append(table.values(Span(0, int(times_ns[-1]) + 1)))
    return pd.DataFrame(rows)
