"""Partitions: every run of every mode, as the environment says."""

import pytest

from assets.partitions import ConfigurationError, run_count, runs_of_modes
from sim.modes import modes


def test_the_thesis_campaign_is_the_default() -> None:
    assert run_count({}) == 15
    assert run_count({"ORACLE_RUNS": ""}) == 15


def test_there_is_a_partition_for_every_run_of_every_mode_in_order() -> None:
    keys = [str(key) for key in runs_of_modes(run_count({"ORACLE_RUNS": "2"})).get_partition_keys()]
    assert keys == [f"{mode}|{run}" for mode in modes() for run in ("run000", "run001")]
    assert keys[0] == "lidar_passthrough|run000"


@pytest.mark.parametrize("value", ["0", "-1", "1.5", "many"])
def test_a_count_that_makes_no_sense_is_named(value: str) -> None:
    with pytest.raises(ConfigurationError, match=f"ORACLE_RUNS is '{value}'"):
        run_count({"ORACLE_RUNS": value})
