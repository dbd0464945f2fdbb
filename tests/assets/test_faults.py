"""Processes that are killed at any time, and concurrent requests for the same run."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from assets.worker.run import process_run
from sim.fan_out import fan_out, process_pool
from tests.assets.laboratory import Laboratory
from tools.soak.aggregates import compared, end, made, wait_for_step
from tools.soak.aggregates import start as start_asset
from tools.soak.aggregates import state as state_of_aggregates
from tools.soak.faults import complete, disturbed, jobs, leftovers, state
from tools.soak.full_disk import everything

pytestmark = pytest.mark.slow(8)

# One of each kind that is written: a table, a folder of results, the pages.
WRITTEN = ("feature_dataset", "bootstrapped_dataset", "oracle_report")
KILLS = 3  # of everything, of a worker and of the caller; `python -m tools.soak.faults` makes 50


def test_a_campaign_killed_at_random_times_ends_like_an_undisturbed_one(tmp_path: Path) -> None:
    quiet, other = tmp_path / "quiet", tmp_path / "disturbed"
    complete(quiet)
    wrong = list(disturbed(other, KILLS, seed=0))
    assert wrong == [[]] * (KILLS + 1)
    assert state(other) == state(quiet)
    assert leftovers(other) == []


def test_of_two_concurrent_requests_for_a_run_one_simulates_it(tmp_path: Path) -> None:
    job = jobs(tmp_path)[0]
    outcomes = list(fan_out(process_run, [job, job], lambda: process_pool(2)))
    statuses = [o.result.assets["bags"].figures["status"] for o in outcomes if o.result]
    assert sorted(statuses) == ["made", "verified"]
    assert leftovers(tmp_path) == []


def test_a_killed_write_leaves_the_old_or_the_new_table_or_report(
    campaign: Laboratory, tmp_path: Path
) -> None:
    root = tmp_path / "data"
    shutil.copytree(campaign.root, root)
    expected = state_of_aggregates(root)
    # A file that replaces another, as pages do, and a folder.
    written = {"datasets": "feature_dataset", "report/parts": "bootstrapped_dataset"}
    for folder, asset in written.items():
        running = next(filter(None, (writing(tmp_path, root / folder, asset) for _ in range(9))))
        assert end(running, "kill all") == []
        assert state_of_aggregates(root) == expected
    assert all(made(root, asset).success for asset in written.values())
    assert compared(root, expected) == []


def writing(home: Path, folder: Path, asset: str) -> "subprocess.Popen[bytes] | None":
    """Return the process of an asset while it writes; None if it ended before it was seen to."""
    running = start_asset(home, [asset])
    wait_for_step(home, running)
    while running.poll() is None:
        if list(folder.glob(".*")):
            return running
    return None


def test_an_interrupted_evaluation_ends_soon_and_leaves_nothing(
    campaign: Laboratory, tmp_path: Path
) -> None:
    root = tmp_path / "data"
    shutil.copytree(campaign.root, root)
    expected = state_of_aggregates(root)
    for _ in range(9):  # on a busy machine, it may have ended before
        running = start_asset(tmp_path, ["oracle_evaluation"])
        wait_for_step(tmp_path, running)
        assert end(running, "terminate") == []
        if running.returncode != 0:
            break
    assert running.returncode != 0
    assert compared(root, expected) == []


def test_on_a_full_disk_no_asset_is_made_and_nothing_is_lost(copy_of_campaign: Laboratory) -> None:
    found = dict(everything(copy_of_campaign.root, np.random.default_rng(15), WRITTEN))
    assert found.keys() == {"recording of a run", "features of a run", *WRITTEN}
    assert not any(found.values()), found
