"""What hardly changes within recordings is a setting or the world, and its level does not count."""

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.datasets import MINUS
from oracle_pipeline.scoring.learning import common_signals, settings_among

RUNS = 12
MAP, SPEED = "signals./map/info.height", "signals./odom/twist.twist.linear.x"


def table(rng: np.random.Generator, within: float) -> pd.DataFrame:
    """Runs in worlds of several sizes; a map changes by so much within each."""
    size = rng.uniform(5.0, 20.0, RUNS)
    speed = rng.normal(0.2, 0.01, RUNS)
    columns = {
        f"{MAP}.mean": size, f"{MAP}.min": size - within, f"{MAP}.max": size + within,
        f"{MAP}.std": np.full(RUNS, within), f"{MAP}.change": np.full(RUNS, within),
        f"{SPEED}.mean": speed, f"{SPEED}.std": rng.uniform(0.08, 0.12, RUNS),
        "signals./scan/period.mean": rng.normal(0.2, 0.01, RUNS),
        "signals./scan/period.std": np.zeros(RUNS),
    }  # fmt: skip
    return pd.DataFrame(columns)


@pytest.mark.parametrize("within", [0.0, 0.1, np.nan])
def test_a_level_that_differs_between_worlds_only_does_not_count(within: float) -> None:
    runs = table(np.random.default_rng(0), within)
    settings = settings_among(runs)
    assert settings == {MAP}
    counted = common_signals(runs, settings)
    assert not any(column.startswith(f"{MAP}.m") for column in counted)
    assert f"{SPEED}.mean" in counted
    assert "signals./scan/period.mean" in counted  # a steady rate is behaviour
    if np.isfinite(within):
        assert f"{MAP}.std" in counted  # that it changes would be news


def test_what_is_zero_in_all_recordings_counts_since_it_may_be_an_error() -> None:
    runs = table(np.random.default_rng(0), within=0.0)
    runs[[f"{MAP}.{level}" for level in ("mean", "min", "max")]] = 0.0
    assert settings_among(runs) == set()


def test_a_signal_that_changes_within_recordings_counts() -> None:
    runs = table(np.random.default_rng(0), within=5.0)
    settings = settings_among(runs)
    assert settings == set()
    assert set(common_signals(runs, settings)) == set(runs.columns)


@pytest.mark.parametrize(("error", "counts"), [(0.05, True), (0.5, False)])
def test_the_difference_from_a_command_counts_if_something_follows_it(
    error: float, counts: bool
) -> None:
    runs = table(np.random.default_rng(0), within=0.0)
    difference = f"{SPEED}{MINUS}cmd_vel.linear.x.std"
    runs[difference] = error
    assert (difference in common_signals(runs, settings_among(runs))) is counts


def test_fields_that_are_named_as_a_lag_are_compared_as_others() -> None:
    columns = ["signals./log/actual.lag minus log.desired.lag.std", "signals./log/actual.lag.std"]
    runs = pd.DataFrame(np.ones((RUNS, 2)), columns=columns)
    assert set(common_signals(runs, set())) == set(columns)
