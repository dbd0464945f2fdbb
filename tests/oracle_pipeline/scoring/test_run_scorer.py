"""Scores of windows for alarms, and of runs by their levels: the few that are farthest count."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.datasets import feature_columns, feature_floors
from oracle_pipeline.detectors import panel
from oracle_pipeline.scoring.learning import learned_scorer
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import (
    ENOUGH_FEATURES,
    OF_FEATURES,
    TOP_FEATURES,
    TOP_WINDOWS,
    Design,
    RunScorer,
)  # fmt: skip
from tests.oracle_pipeline.datasets.synthetic import campaign

FEATURES, WINDOWS, _ = campaign(20, 0.0, 0, {"lidar_passthrough": "normal"})
COLUMNS = feature_columns(WINDOWS)
CHANGED = COLUMNS[:TOP_FEATURES]


def fitted(windows):
    columns = feature_columns(windows)
    design = Design(panel(0)["mahalanobis"], [], columns, feature_floors(FEATURES))
    return RunScorer(design).fit(MeasuredRuns.ordered(FEATURES, windows))


def beyond(windows, scorer, times):
    """Return one window whose first features are at a multiple of what normal windows reach."""
    scaler = scorer.models_["windows"][0]
    window = windows.iloc[[0]].copy()
    for name in CHANGED:
        place = scaler.kept_.index(name)
        reach = times * scorer.reach_["windows"][place]
        window[name] = scaler.center_[place] + reach * scaler.scale_[place]
    return window


def test_no_fitted_window_is_beyond_what_fitted_windows_reach():
    scorer = fitted(WINDOWS)
    assert scorer.alarm_scores(WINDOWS).max() <= 1.0
    for column, normal in scorer.normal_in_windows.items():
        assert normal.low <= WINDOWS[column].min() <= normal.usual == WINDOWS[column].median()
        assert WINDOWS[column].max() <= normal.high


@given(times=st.floats(1.1, 5.0), others=st.integers(0, 200))
def test_a_change_of_few_features_is_not_lost_among_many_others(times, others):
    noise = np.random.default_rng(0).normal(size=(len(WINDOWS), others))
    more = pd.DataFrame(noise, WINDOWS.index, [f"other.feature{n}" for n in range(others)])
    windows = pd.concat([WINDOWS, more], axis=1)
    scorer = fitted(windows)
    np.testing.assert_allclose(scorer.alarm_scores(beyond(windows, scorer, times)), times)


@pytest.mark.parametrize("known", [ENOUGH_FEATURES - 1, ENOUGH_FEATURES])
def test_signals_raise_alarms_where_few_features_know_the_robot(known):
    rng, count = np.random.default_rng(0), len(WINDOWS)
    columns = [f"motion.feature{n}" for n in range(known)]
    signals = ["signals./arm/elbow.mean", "signals./arm/wrist.mean", "signals./arm/wrist.std"]
    values = rng.normal(size=(count, known + len(signals)))
    table = WINDOWS[["run_id", "window_start_s"]].join(
        pd.DataFrame(values, WINDOWS.index, [*columns, *signals])
    )
    levels = (*OF_FEATURES, "signal windows")
    design = Design(panel(0)["mahalanobis"], [], columns, {}, (), signals, levels)
    scorer = RunScorer(design).fit(MeasuredRuns.ordered(FEATURES, table))
    stuck = table.iloc[[0]].copy()
    stuck[signals] += 100.0
    before, after = (scorer.alarm_scores(each)[0] for each in (table.iloc[[0]], stuck))
    assert (after > 5.0) if known < ENOUGH_FEATURES else (after == before)
    families = scorer.unusual_families(stuck)[0]
    assert (families == ["/arm"]) if known < ENOUGH_FEATURES else ("/arm" not in families)


def test_what_leaves_its_range_is_not_hidden_by_a_hundred_signals_that_scatter():
    rng = np.random.default_rng(3)
    turned = np.concatenate([rng.uniform(1.0, 2.0, 40), rng.uniform(0.1, 0.3, 20)])
    columns = {f"signals./noisy{j % 5}/{j}.mean": rng.standard_t(1.5, 60) for j in range(100)}
    columns |= {f"signals./odom/{j}.mean": j * turned for j in range(1, 11)}
    keys = {"run_id": [f"{n:02d}" for n in range(60)], "label": "normal", "block": np.arange(60)}
    table = pd.DataFrame(keys | {"structural.nodes": rng.normal(size=60)} | columns)
    table.attrs = {"fields": {"structural.nodes": {}}}
    runs = MeasuredRuns.ordered(table, table[["run_id"]].assign(window_start_s=0.0))
    normal, new = runs.where(np.arange(60) < 30), runs.where(np.arange(60) >= 30)
    scorer = learned_scorer(normal)
    scores = scorer.own_score(scorer.scores(new))
    assert np.mean(np.subtract.outer(scores[10:], scores[:10]) > 0.0) > 0.9


def test_a_short_attack_at_the_end_of_a_long_run_counts_as_much_as_at_its_start():
    longer = FEATURES["run_id"].iloc[0]
    normal = WINDOWS[(WINDOWS["run_id"] == longer) | (WINDOWS["window_start_s"] < 30.0)]
    scorer, scores = fitted(normal), []
    for place in (slice(TOP_WINDOWS), slice(-TOP_WINDOWS, None)):
        attacked = normal[normal["run_id"] == longer].copy()
        attacked.loc[attacked.index[place], CHANGED] += 100.0
        run = MeasuredRuns.ordered(FEATURES.iloc[[0]], attacked)
        scores.append(scorer.score(run)[0])
    np.testing.assert_allclose(scores[1], scores[0], rtol=0.2)
    assert scores[0] > 5.0 * scorer.score(MeasuredRuns.ordered(FEATURES, normal)).max()
