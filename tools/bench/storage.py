"""Disk space of a run under each storage plan, and memory for many runs."""

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.manifest import KEPT, Kept
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.storage.stock import take_stock
from sim.campaigns import Campaign
from sim.fan_out import fan_out, process_pool
from tools.bench.figures import Row, median, spread

MODES = ("lidar_passthrough", "fake_object", "delayed_fakeobject")
MANY = (100, 1000)
_IN_A_PROCESS = (
    "import sys; from tools.bench.storage import verify; verify(sys.argv[1], int(sys.argv[2]))"
)


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        runs = [RunDirectory(root, mode, 0) for mode in MODES]
        for run in runs:
            _process(run, "full")
        yield from _bytes_of_runs(root, runs)
        for number in MANY:
            yield _peak_memory(root, number)
        yield _walk(root)


def _process(run: RunDirectory, keep: Kept) -> float:
    started = time.perf_counter()
    process_run(RunJob(run, Campaign(), OF_A_RUN, refresh=False, keep=keep))
    return time.perf_counter() - started


def _bytes_of_runs(root: Path, runs: list[RunDirectory]) -> Iterator[Row]:
    for kept in KEPT:
        seconds = [_process(run, kept) for run in runs]
        stock = take_stock(root)
        megabytes = [stock.runs[run].total / 1e6 for run in runs]
        yield Row(f"a run of 8 goals, kept: {kept}", median(megabytes), "MB", None, True,
                  spread(megabytes))  # fmt: skip
        yield Row("  time to verify and to reduce it", median(seconds), "s", None, True,
                  spread(seconds))  # fmt: skip


def _peak_memory(root: Path, number: int) -> Row:
    command = [sys.executable, "-c", _IN_A_PROCESS, str(root), str(number)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return Row(f"peak memory after verifying {number} runs", float(done.stdout), "MiB")


def verify(root: str, number: int) -> None:
    """Verify one run many times, and print the peak memory of this process [MiB]."""
    run = RunDirectory(Path(root), MODES[0], 0)
    job = RunJob(run, Campaign(), OF_A_RUN, refresh=False)
    for outcome in fan_out(process_run, [job] * number, lambda: process_pool(2)):
        if outcome.error is not None:
            raise RuntimeError(outcome.error)
    status = Path("/proc/self/status").read_text()  # rusage would include the parent's peak
    print(float(status.partition("VmHWM:")[2].split()[0]) / 1024)


def _walk(root: Path) -> Row:
    """Measure how long it takes to take stock of a thousand runs."""
    for number in range(1, 1000):
        copy = RunDirectory(root, MODES[0], number)
        shutil.copytree(RunDirectory(root, MODES[0], 0).path, copy.path, copy_function=_link)
    started = time.perf_counter()
    runs = len(take_stock(root).runs)
    return Row(f"time to take stock of {runs} runs", time.perf_counter() - started, "s")


def _link(source: str, target: str) -> None:
    Path(target).hardlink_to(source)
