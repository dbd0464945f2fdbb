"""A campaign that is killed at random moments must end like an undisturbed one.

``python -m tools.soak.faults`` repeats a test of the suite many more times. It kills all processes,
or only the caller (its workers must end, too), or one worker (the caller must continue).
"""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.layout import TABLES
from oracle_pipeline.bags.manifest import Kept
from oracle_pipeline.bags.reader import content_hash
from oracle_pipeline.bags.run_directory import RunDirectory, bytes_on_disk, find_runs
from oracle_pipeline.datasets import content_hash as table_hash
from oracle_pipeline.datasets import read_table
from sim.campaigns import Campaign
from sim.fan_out import fan_out, process_pool

RUNS: tuple[tuple[str, int, Kept], ...] = (
    ("atc_ghost_static", 0, "trimmed"),
    ("atc_normal", 0, "recipe"),
    ("atc_normal", 1, "full"),
)
SHORT = Campaign(timeout_s=20.0)
WORKERS = 2
LATEST_S = 2.0  # latest moment of a kill, after the first worker has begun
LONGEST_S = 10.0  # longest time that a worker may outlive its caller

_COMMAND = "import sys; from tools.soak.faults import run_campaign; run_campaign(sys.argv[1])"


def jobs(root: Path) -> list[RunJob]:
    """Return the jobs of the campaign."""
    return [
        RunJob(RunDirectory(root, mode, run), SHORT, OF_A_RUN, refresh=False, keep=kept)
        for mode, run, kept in RUNS
    ]


def run_campaign(root: str) -> None:
    """Simulate all runs below a root, and raise an error if one fails."""
    for outcome in fan_out(process_run, jobs(Path(root)), lambda: process_pool(WORKERS)):
        if outcome.error is not None:
            raise RuntimeError(outcome.error)


def complete(root: Path) -> None:
    """Simulate the runs below a root that are missing, undisturbed and in this process."""
    for job in jobs(root):
        process_run(job)


def start(root: Path) -> "subprocess.Popen[bytes]":
    """Start a campaign as a process group of its own."""
    command = [sys.executable, "-c", _COMMAND, str(root)]
    return subprocess.Popen(
        command, cwd=Path(__file__).parents[2], start_new_session=True, stderr=subprocess.DEVNULL
    )


def strike(campaign: "subprocess.Popen[bytes]", rng: np.random.Generator, whom: str) -> None:
    """Kill a campaign at a random moment after its first run began."""
    time.sleep(rng.uniform(0.0, LATEST_S))
    if campaign.poll() is not None:
        return
    if whom == "all":
        os.killpg(campaign.pid, signal.SIGKILL)
    elif whom == "caller":
        campaign.kill()
    else:
        for worker in rng.permutation(_workers(campaign.pid))[:1].tolist():
            with contextlib.suppress(ProcessLookupError):
                os.kill(worker, signal.SIGKILL)
    campaign.wait()


def _workers(caller: int) -> list[int]:
    """Return the worker processes of a caller: forks of its fork server."""
    return [
        worker
        for child in _children(caller)
        if b"forkserver" in Path(f"/proc/{child}/cmdline").read_bytes()
        for worker in _children(child)
    ]


def _children(process: int) -> list[int]:
    """Return the processes that one has started, in any of its threads."""
    return [
        int(child)
        for of_thread in Path(f"/proc/{process}/task").glob("*/children")
        for child in of_thread.read_text().split()
    ]


def wait_until_gone(campaign: "subprocess.Popen[bytes]") -> bool:
    """Return whether all processes of a campaign end in time."""
    deadline = time.monotonic() + LONGEST_S
    while time.monotonic() < deadline:
        try:
            os.killpg(campaign.pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.2)
    return False


def wait_for_work(root: Path, campaign: "subprocess.Popen[bytes]") -> None:
    """Wait until a worker has begun a run."""
    while campaign.poll() is None and not any(root.glob("runs/*/.lock-*")):
        time.sleep(0.05)


def state(root: Path) -> dict[str, Any]:
    """Return what is stored about the runs below a root, without times and sizes."""
    return {run.key: _known(run) for run in find_runs(root)}


def _known(run: RunDirectory) -> dict[str, Any]:
    document = asdict(run.manifest())
    kept = document.pop("measured")["kept"]
    graphs = {file.name: file.read_bytes() for file in sorted(run.graphs.iterdir())}
    features = {table: table_hash(read_table(run.feature_table(table))) for table in TABLES}
    return {"kept": kept, "graphs": graphs, "features": features, **document}


def damaged(root: Path) -> list[str]:
    """Return the runs that look finished but are incomplete."""
    return [run.key for run in find_runs(root) if not _is_whole(run)]


def _is_whole(run: RunDirectory) -> bool:
    manifest = run.manifest()
    if bytes_on_disk(run.path) != manifest.measured.bytes:
        return False
    return manifest.measured.kept != "full" or content_hash(run.bag) == manifest.content_hash


def made_in(root: Path) -> dict[str, float]:
    """Return how long each finished run took; a changed figure means a second simulation."""
    return {run.key: run.manifest().measured.wall_s for run in find_runs(root)}


def leftovers(root: Path) -> list[str]:
    """Return the files that dead processes left behind."""
    return sorted(str(path.relative_to(root)) for path in root.rglob(".*"))


def disturbed(root: Path, kills: int, seed: int) -> Iterator[list[str]]:
    """Kill a campaign many times, then complete it; yield the faults after each kill."""
    rng = np.random.default_rng(seed)
    first_made: dict[str, float] = {}
    for number in range(kills):
        campaign = start(root)
        wait_for_work(root, campaign)
        whom = ("all", "caller", "worker")[number % 3]  # a campaign survives the last
        strike(campaign, rng, whom)
        wrong = [f"{key} looks finished but is damaged" for key in damaged(root)]
        if whom == "caller" and not wait_until_gone(campaign):
            os.killpg(campaign.pid, signal.SIGKILL)
            wrong.append("workers outlived their caller")
        first_made = made_in(root) | first_made
        yield wrong
    complete(root)
    made = made_in(root)
    yield [
        f"{key} was finished and then simulated again"
        for key, s in first_made.items()
        if made[key] != s
    ]


def main() -> None:
    """Kill a campaign many times, and check that its result equals that of an undisturbed one."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.faults", description=main.__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        quiet, other = Path(folder, "quiet"), Path(folder, "disturbed")
        complete(quiet)
        wrong: list[str] = []
        for number, wrong_now in enumerate(
            disturbed(other, arguments.kills, arguments.seed), start=1
        ):
            print(f"{number}: {'; '.join(wrong_now) or 'no faults'}", flush=True)
            wrong += wrong_now
        if state(other) != state(quiet):
            wrong.append("the runs differ from those of an undisturbed campaign")
        wrong += [f"{name} was left behind" for name in leftovers(other)]
    print("\n".join(wrong) or f"{arguments.kills} kills: nothing was lost or damaged.")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
