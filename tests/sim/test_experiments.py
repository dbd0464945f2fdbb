"""A run is recorded completely or not at all, verified if it exists, and rebuilt on demand."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.run_directory import RunDirectory, find_runs
from sim.experiments import recipe_for, record_run
from tests.recorded_runs import ONE_GOAL, copied
from tests.servers import end_with_parent

pytestmark = pytest.mark.slow

RECIPE = recipe_for("lidar_passthrough", 0, ONE_GOAL)


@pytest.fixture
def finished(recorded_run, tmp_path):
    """A run of one goal, to be damaged."""
    return copied(recorded_run("lidar_passthrough"), tmp_path)


def test_a_finished_run_is_verified_and_not_simulated_again(finished):
    directory = finished
    before = directory.manifest_path.stat().st_mtime_ns
    assert record_run(RECIPE, directory) == directory.manifest()
    assert directory.manifest_path.stat().st_mtime_ns == before


def test_a_place_with_the_run_of_another_recipe_is_left_unchanged(finished):
    recipe = recipe_for(finished.mode, 0, replace(ONE_GOAL, seed=1))
    before = finished.manifest()
    with pytest.raises(OracleError, match="another recipe .*differs in seed.*choose another root"):
        record_run(recipe, finished)
    assert finished.manifest() == before


def test_a_damaged_run_is_named_and_can_be_rebuilt(finished):
    (file,) = finished.bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-1000])
    with pytest.raises(OracleError, match="is damaged.*simulate it again with --refresh"):
        record_run(RECIPE, finished)
    again = record_run(RECIPE, finished, refresh=True)
    assert again.content_hash == finished.manifest().content_hash
    record_run(RECIPE, finished)


def test_a_run_that_was_killed_leaves_nothing_that_looks_finished_and_is_made_by_the_next_call(
    tmp_path,
):
    call = [
        sys.executable, "-c",
        "from pathlib import Path\n"
        "from oracle_pipeline.bags.run_directory import RunDirectory\n"
        "from sim.campaigns import Campaign\n"
        "from sim.experiments import recipe_for, record_run\n"
        "recipe = recipe_for('lidar_passthrough', 0, Campaign(goals_per_run=8))\n"
        f"record_run(recipe, RunDirectory(Path({str(tmp_path)!r}), 'lidar_passthrough', 0))",
    ]  # fmt: skip
    process = subprocess.Popen(call, preexec_fn=end_with_parent())
    scratch = tmp_path / "runs" / "lidar_passthrough"
    while not list(scratch.glob(".run000.*/bag*/*")):
        assert process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert find_runs(tmp_path) == []
    assert not (scratch / "run000").exists()
    directory = RunDirectory(tmp_path, "lidar_passthrough", 0)
    record_run(recipe_for("lidar_passthrough", 0, replace(ONE_GOAL, timeout_s=6.0)), directory)
    assert [path.name for path in scratch.iterdir()] == ["run000"]


def test_sqlite_bags_hold_the_same_messages(tmp_path):
    made = {}
    for storage in ("mcap", "sqlite3"):
        directory = RunDirectory(tmp_path / storage, "random_noise", 0)
        campaign = replace(ONE_GOAL, storage=storage, timeout_s=20.0)
        made[storage] = record_run(recipe_for("random_noise", 0, campaign), directory)
        assert [
            file.suffix for file in directory.bag.iterdir() if file.name != "metadata.yaml"
        ] == [{"mcap": ".mcap", "sqlite3": ".db3"}[storage]]
    assert made["mcap"].content_hash == made["sqlite3"].content_hash
