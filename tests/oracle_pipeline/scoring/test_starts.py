"""Recordings that lack the start of a run."""

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.starts import LATE, effects_of_start

RUNS, COUNT = 40, 12
OWN, PLACE = "signals./joint_states/position", "signals./odom/x"
STATISTICS = ("mean", "std", "min", "max", "change")


def measured(first, rng, windows=COUNT):
    """Runs in which one signal has another mean in the first windows than later."""
    keys = [
        {"run_id": f"{run:02}", "window_start_s": 5.0 * number, "label": "normal"}
        for run in range(RUNS)
        for number in range(windows)
    ]
    table = pd.DataFrame(keys)
    starts = table["window_start_s"] < 5.0 * LATE
    for name, level in ((OWN, np.where(starts, first, 0.0)), (PLACE, 0.0)):
        table[f"{name}.mean"] = level + rng.normal(size=len(table))
        table[f"{name}.std"] = rng.uniform(0.5, 1.5, len(table))
        table[f"{name}.change"] = rng.uniform(0.5, 1.5, len(table))
    return MeasuredRuns.ordered(table[["run_id", "label"]].drop_duplicates(), table)


def of_runs(runs, name, statistic):
    """The statistics of whole runs."""
    windows = runs.windows
    if statistic in {"min", "max"}:
        sign = -1.0 if statistic == "min" else 1.0
        ends = windows[f"{name}.mean"] + sign * 2.0 * windows[f"{name}.std"]
        return ends.groupby(runs.run).agg(statistic)
    return windows.groupby(runs.run)[f"{name}.{statistic}"].mean()


@pytest.mark.parametrize("first", [-20.0, 20.0])
def test_what_only_the_first_seconds_have_is_what_a_late_recording_differs_by(first):
    effects = effects_of_start(measured(first, np.random.default_rng(0)))
    extreme, other = ("min", "max") if first < 0.0 else ("max", "min")
    assert effects[f"{OWN}.{extreme}"] == pytest.approx(20.0, abs=2.0)
    assert effects[f"{OWN}.mean"] == pytest.approx(20.0 * LATE / COUNT, abs=0.5)
    assert effects[f"{OWN}.{other}"] == 0.0


@pytest.mark.parametrize("statistic", STATISTICS)
def test_a_start_that_is_like_the_rest_makes_no_difference_that_counts(statistic):
    runs = measured(20.0, np.random.default_rng(0))
    effect = effects_of_start(runs)[f"{PLACE}.{statistic}"]
    assert effect < of_runs(runs, PLACE, statistic).std()


def test_messages_may_be_missing_in_windows_and_runs_may_be_short():
    runs = measured(20.0, np.random.default_rng(0))
    columns = [column for column in runs.windows if column.startswith(OWN)]
    runs.windows.loc[runs.place % 2 == 1, columns] = np.nan
    assert effects_of_start(runs)[f"{OWN}.max"] == pytest.approx(20.0, abs=2.0)
    runs.windows[columns] = np.nan
    assert not any(column.startswith(OWN) for column in effects_of_start(runs))
    assert effects_of_start(measured(20.0, np.random.default_rng(0), windows=LATE)) == {}
