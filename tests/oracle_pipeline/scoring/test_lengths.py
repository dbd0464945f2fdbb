"""Recordings of other lengths than those of a reference."""

import json
from dataclasses import replace

import numpy as np
import pytest

from oracle_pipeline.datasets import MISSING, Fields, feature_columns
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.lengths import comparable_tables
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import OF_FEATURES, OF_SIGNALS
from tests.oracle_pipeline.scoring.test_cross_conformal import design, learned, runs

SIGNAL = "signals./imu/angular_velocity.z.mean"
TOTAL, *RATES = feature_columns(runs(1, seed=0).features)


def tables(seconds):
    """One normal run, cut or repeated to some length."""
    run = runs(1, seed=1)
    count = round(seconds / 2.5)
    windows = run.windows.iloc[np.resize(np.arange(len(run.windows)), count)]
    windows = windows.assign(window_start_s=2.5 * np.arange(count))
    features = run.features.assign(**{MISSING: "{}"})
    features.attrs["fields"] = Fields({TOTAL: {"extensive": "true"}})
    return FeatureTables(features, windows)


@pytest.mark.parametrize(("windows", "told"), [(3, "shorter"), (8, None), (20, "longer")])
def test_only_outside_the_lengths_of_the_reference_totals_are_left_out_with_a_note(windows, told):
    before = tables(2.5 * windows)
    after, notes = comparable_tables(before, (4, 10))
    assert [told in note for note in notes] == ([True] if told else [])
    assert np.isnan(after.run[TOTAL].iloc[0]) == (told is not None)
    assert after.run[RATES].equals(before.run[RATES])
    assert (TOTAL in json.loads(after.run[MISSING].iloc[0])) == (told is not None)


def test_the_same_run_over_a_shorter_time_may_scatter_more():
    scorer, run = learned(runs(20, seed=0)), runs(1, seed=2)
    far = run.features.copy()
    far[[TOTAL, *RATES]] += 5.0
    shortest = scorer.lengths[0]
    scores = [
        scorer.scores(MeasuredRuns.ordered(far, run.windows.iloc[:count])).max()
        for count in (shortest, shortest // 4)
    ]
    assert scores[1] < 0.7 * scores[0]


@pytest.mark.parametrize("times", [0.5, 0.95, 1, 1.05, 2])
def test_beside_features_signals_of_the_whole_count_only_within_the_lengths(times):
    normal = with_signal(runs(20, seed=0), 0.0)
    described = replace(design(normal), run_signals=[SIGNAL], levels=(*OF_FEATURES, *OF_SIGNALS))
    scorer = CrossConformalScorer(described).fit(normal, np.random.default_rng(0))
    windows = runs(1, seed=2).windows
    count = round(times * len(windows))
    windows = windows.iloc[np.resize(np.arange(len(windows)), count)]
    windows = windows.assign(window_start_s=2.5 * np.arange(count))
    near, far = (
        scorer.scores(MeasuredRuns.ordered(with_signal(runs(1, seed=2), off).features, windows))
        for off in (0.0, 100.0)
    )
    assert (far.max() > near.max() + 5.0) == (0.9 < times < 1.1)


def with_signal(measured, off):
    """Add the mean of a signal to the features of runs."""
    rng = np.random.default_rng(3)
    columns = {SIGNAL: off + rng.normal(size=len(measured.features))}
    features = measured.features.assign(**columns)
    return MeasuredRuns.ordered(features, measured.windows)
