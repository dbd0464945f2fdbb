"""Processes that are killed at any moment, and two that want the same run at once."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

from assets.aggregates import DATASET, TRUTH, WINDOWS
from assets.worker.run import process_run
from oracle_pipeline.datasets import read_table
from oracle_pipeline.reporting.report import Report
from resources.store import RunStore
from sim.fan_out import fan_out, process_pool
from soak.faults import disturbed, jobs, leftovers, start, state
from tests.assets.laboratory import EVERYTHING, PER_RUN, Laboratory

KILLS = 5
DAGSTER = str(Path(sys.executable).parent / "dagster")
REPORTS = [
    name for name in EVERYTHING if name not in (*PER_RUN, "feature_dataset", "oracle_report")
]


def test_a_campaign_killed_at_random_moments_ends_as_one_left_alone(tmp_path: Path) -> None:
    quiet, other = tmp_path / "quiet", tmp_path / "disturbed"
    undisturbed = start(quiet)
    wrong = list(disturbed(other, KILLS, seed=0))
    assert wrong == [[]] * (KILLS + 1)
    assert undisturbed.wait() == 0
    assert state(other) == state(quiet)
    assert leftovers(other) == []


def test_of_two_who_want_the_same_run_at_once_one_makes_it(tmp_path: Path) -> None:
    job = jobs(tmp_path)[0]
    outcomes = list(fan_out(process_run, [job, job], lambda: process_pool(2)))
    statuses = [o.result.assets["bags"].figures["status"] for o in outcomes if o.result]
    assert sorted(statuses) == ["made", "verified"]
    assert leftovers(tmp_path) == []


def test_tables_and_reports_killed_while_they_are_written_are_the_former_or_the_new(
    campaign: Laboratory, tmp_path: Path
) -> None:
    root = tmp_path / "data"
    shutil.copytree(campaign.root, root)
    written = {
        "datasets": "feature_dataset",
        "report/parts": "malicious_rate_report",
        "report": "oracle_report",
    }
    for folder, asset in written.items():
        running = materialize(tmp_path, asset)
        while not list((root / folder).glob(".*")):
            assert running.poll() is None
            time.sleep(0.001)
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        assert_equal_tables(RunStore(root=str(root)), campaign.store)
    assert materialize(tmp_path, ",".join(written.values())).wait() == 0
    assert_equal_tables(RunStore(root=str(root)), campaign.store)
    assert leftovers(root) == []


def materialize(place: Path, assets: str) -> "subprocess.Popen[bytes]":
    """Make what is made of all runs, as a process group of its own."""
    (place / "home").mkdir(exist_ok=True)
    ours = {"DAGSTER_HOME": str(place / "home"), "ORACLE_HOME": str(place / "data")}
    command = ["asset", "materialize", "-m", "oracle_pipeline.definitions", "--select"]
    return subprocess.Popen(
        [DAGSTER, *command, assets], cwd=place, env=os.environ | ours,
        start_new_session=True, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def assert_equal_tables(found: RunStore, expected: RunStore) -> None:
    for name in (DATASET, WINDOWS, TRUTH):
        pd.testing.assert_frame_equal(
            read_table(found.dataset(name)), read_table(expected.dataset(name))
        )
    for name in REPORTS:
        ours, theirs = (Report.load(store.results(name)) for store in (found, expected))
        pd.testing.assert_frame_equal(ours.table, theirs.table)
        assert ours.figures == theirs.figures
