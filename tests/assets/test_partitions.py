"""Partitions: every run of every mode, configured by the environment."""

import os
import re
import subprocess
import sys
from pathlib import Path

import dagster as dg
import pytest

from assets.partitions import ConfigurationError, chosen_modes, run_count, runs_of_modes
from sim.modes import FOLDER, modes
from tests.assets.laboratory import ROOT


def test_the_thesis_campaign_is_the_default() -> None:
    assert run_count({}) == 15
    assert run_count({"ORACLE_RUNS": ""}) == 15


def test_there_is_a_partition_for_every_run_of_every_mode_in_order() -> None:
    campaign = runs_of_modes(chosen_modes({}), run_count({"ORACLE_RUNS": "2"}))
    keys = [str(key) for key in campaign.get_partition_keys()]
    assert keys == [f"{mode}|{run}" for mode in modes() for run in ("run000", "run001")]
    assert keys[0] == "lidar_passthrough|run000"


@pytest.mark.parametrize("value", ["0", "-1", "1.5", "many"])
def test_an_invalid_count_is_an_error_with_its_value(value: str) -> None:
    with pytest.raises(ConfigurationError, match=f"ORACLE_RUNS is '{value}'"):
        run_count({"ORACLE_RUNS": value})


@pytest.mark.parametrize(
    ("text", "first", "count"),
    [
        ("", "lidar_passthrough", len(modes())),
        ("turtlebot3", "lidar_passthrough", 15),
        ("atc", "atc_normal", 17),
        ("delayed_*_shadow", "delayed_fakeobject_shadow", 1),
        ("benign_*, fake_object", "fake_object", 7),
    ],
)
def test_a_choice_of_modes_keeps_their_order(text: str, first: str, count: int) -> None:
    chosen = chosen_modes({"ORACLE_MODES": text})
    assert chosen[0] == first
    assert len(chosen) == count
    assert chosen == [mode for mode in modes() if mode in chosen]


@pytest.mark.parametrize("part", ["fake_objects", "Turtlebot3", ""])
def test_a_choice_that_matches_no_mode_is_an_error(part: str) -> None:
    with pytest.raises(ConfigurationError, match=f"'{part}' matches no mode.*turtlebot3, atc"):
        chosen_modes({"ORACLE_MODES": f"fake_object,{part}"})


def test_the_range_of_make_run_is_the_six_modes_and_nothing_else() -> None:
    first, last = re.findall(r"^(?:FIRST|LAST) := (.+)$", (ROOT / "Makefile").read_text(), re.M)
    keys = runs_of_modes(chosen_modes({}), 15).get_partition_keys_in_range(
        dg.PartitionKeyRange(first, last)
    )
    assert [str(key) for key in keys] == [
        f"{mode}|run00{run}" for mode in list(modes())[:6] for run in range(3)
    ]


@pytest.mark.slow
def test_scenario_files_are_partitions_and_an_invalid_one_is_only_logged(tmp_path: Path) -> None:
    scenario = (
        "schema: mutant/v1\nid: {}\nlabel: malicious\n"
        "main: {{type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}}\n"
    )
    (tmp_path / "own.yaml").write_text(scenario.format("own"))
    (tmp_path / "broken.yaml").write_text(scenario.format("Broken"))
    loaded = subprocess.run(
        [sys.executable, "-c", "from oracle_pipeline.definitions import defs\n"
         "from assets.partitions import RUNS\n"
         "print(*map(str, RUNS.get_partition_keys()))"],
        env={**os.environ, FOLDER: str(tmp_path)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    modes_there = {key.split("|")[0] for key in loaded.stdout.split()}
    assert "own" in modes_there
    assert "Broken" not in modes_there
    assert f"Left out: {tmp_path}/broken.yaml:2:1: id: expected a name" in loaded.stderr
