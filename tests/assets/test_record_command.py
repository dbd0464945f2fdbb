"""The command that records further runs, as the report prints it."""

import re
import shlex

import dagster as dg
import pytest

from assets.partitions import chosen_modes, runs_of_modes
from assets.record_command import REPEATED, record_command
from sim.modes import modes

SIX = list(modes())[:6]


def keys_of(command: str) -> list[str]:
    """Return the partitions of a command, under its settings."""
    words = shlex.split(command)
    settings = dict(word.split("=") for word in words if word.startswith("ORACLE_"))
    first, last = words[words.index("--partition-range") + 1].split("...")
    chosen = dg.PartitionKeyRange(first, last)
    campaign = runs_of_modes(chosen_modes(settings), int(settings.get("ORACLE_RUNS", "15")))
    return [str(key) for key in campaign.get_partition_keys_in_range(chosen)]


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ORACLE_MODES", "ORACLE_RUNS", *REPEATED):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("blocks", [3, 20])
def test_the_command_covers_every_needed_run(blocks: int) -> None:
    keys = keys_of(record_command(SIX, blocks, "turtlebot3"))
    assert keys == [f"{mode}|run{run:03d}" for mode in SIX for run in range(blocks)]


def test_settings_of_the_campaign_are_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORACLE_HOME", "my campaign")
    monkeypatch.setenv("ORACLE_GOALS_PER_RUN", "4")
    monkeypatch.setenv("ORACLE_RUNS", "60")
    command = record_command(SIX, 20, "turtlebot3")
    assert "ORACLE_HOME='my campaign' ORACLE_GOALS_PER_RUN=4 ORACLE_RUNS=60 dagster" in command
    assert re.search(r"run000\.\.\.delayed_fakeobject\|run019", command)


def test_modes_that_are_not_partitions_are_enabled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORACLE_MODES", "fake_object")
    assert "ORACLE_MODES" not in record_command(["fake_object"], 2, "turtlebot3")
    command = record_command(SIX, 2, "turtlebot3")
    assert {key.partition("|")[0] for key in keys_of(command)} == set(SIX)
    assert "ORACLE_MODES='*'" in command


def test_modes_of_other_testbeds_are_not_asked_for() -> None:
    command = record_command([*SIX, "benign_obstacle", "atc_normal"], 2, "atc")
    assert {key.partition("|")[0] for key in keys_of(command)} == {"atc_normal"}
    every = {key.partition("|")[0] for key in keys_of(record_command(SIX, 1, "atc"))}
    assert every == {mode for mode in modes() if mode.startswith("atc_")}
