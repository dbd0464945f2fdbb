"""Interrupting an asset must leave nothing lost, damaged or half-written.

``python -m tools.soak.aggregates`` simulates a small campaign. Then it materializes the tables and
reports over all runs, one after the other, and interrupts each at a random moment of its step: it
kills all processes, or only the caller, or sends the caller SIGTERM. After each interruption, every
table and report must be complete and have its former content. Runs in progress get SIGTERM, too.
"""

import argparse
import contextlib
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import dagster as dg
import numpy as np

from assets.aggregates import DATASET, TRUTH, WINDOWS
from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.reader import content_hash as content_hash_of_bag
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import content_hash, read_table
from oracle_pipeline.definitions import build_defs
from oracle_pipeline.reporting.stored_report import Report
from resources.fleet import Fleet
from resources.store import RunStore
from sim.campaigns import Campaign
from tools.soak.faults import LATEST_S, leftovers, wait_until_gone

RUNS = [(mode, run) for mode in ("lidar_passthrough", "random_noise") for run in range(2)]
REPORTS = (
    "bootstrapped_dataset",
    "clustering_grid_search",
    "malicious_rate_report",
    "pairwise_report",
    "oracle_evaluation",
)
RUN_ASSETS = sorted(OF_A_RUN)
AGGREGATES = ("feature_dataset", *REPORTS, "oracle_report")
KILLED = ("oracle_evaluation", "oracle_report", "feature_dataset", "clustering_grid_search")
ENDINGS = ("kill all", "kill the caller", "terminate")

_COMMAND = ("asset", "materialize", "-m", "oracle_pipeline.definitions", "--select")
_STARTED = b"STEP_START"  # in the log, when the step of an asset begins
_LOG = "log"


def make_campaign(root: Path) -> None:
    """Simulate a few short runs and materialize all assets over them."""
    campaign = Campaign(goals_per_run=1)
    for mode, run in RUNS:
        place = RunDirectory(root, mode, run)
        process_run(RunJob(place, campaign, OF_A_RUN, refresh=False))
    for asset in AGGREGATES:
        if not made(root, asset).success:
            raise RuntimeError(f"{asset} could not be materialized.")


def made(root: Path, asset: str) -> dg.ExecuteInProcessResult:
    """Materialize an asset over all runs in this process."""
    resources = {"store": RunStore(root=str(root)), "fleet": Fleet(workers=2)}
    job = build_defs(**resources).resolve_implicit_global_asset_job_def()
    return job.execute_in_process(
        asset_selection=[dg.AssetKey(asset)],
        instance=dg.DagsterInstance.ephemeral(),
        raise_on_error=False,
    )


def start(place: Path, assets: Sequence[str], *options: str) -> "subprocess.Popen[bytes]":
    """Start materializing assets in a new process group; the root is ``<place>/data``."""
    (place / "home").mkdir(exist_ok=True)
    ours = {
        "DAGSTER_HOME": str(place / "home"),
        "ORACLE_HOME": str(place / "data"),
        "ORACLE_GOALS_PER_RUN": "1",
    }
    dagster = str(Path(sys.executable).parent / "dagster")
    with (place / _LOG).open("wb") as log:
        return subprocess.Popen(
            [dagster, *_COMMAND, ",".join(assets), *options], cwd=place, env=os.environ | ours,
            start_new_session=True, stderr=log, stdout=log,
        )  # fmt: skip


def wait_for_step(place: Path, running: "subprocess.Popen[bytes]") -> None:
    """Wait until the step of an asset begins."""
    while running.poll() is None and _STARTED not in (place / _LOG).read_bytes():
        time.sleep(0.02)


def end(running: "subprocess.Popen[bytes]", how: str) -> list[str]:
    """End a process group, and return the faults."""
    if how == "terminate":
        running.terminate()
    elif how == "kill all":
        os.killpg(running.pid, signal.SIGKILL)
    else:
        running.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        running.wait(timeout=30)
    if wait_until_gone(running):
        return []
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    return [f"{how}: processes did not end"]


def state(root: Path) -> dict[str, str]:
    """Return a hash of the content of each table and report, or why it cannot be read."""
    store = RunStore(root=str(root))
    tables = {
        name: _content_of(_of_table, store.dataset(name)) for name in (DATASET, WINDOWS, TRUTH)
    }
    reports = {name: _content_of(_of_report, store.results(name)) for name in REPORTS}
    return {**tables, **reports, "oracle_report": _content_of(_of_page, store.report)}


def _content_of(read: Callable[[Path], str], place: Path) -> str:
    try:
        return read(place)
    except (OracleError, OSError) as error:
        return str(error)


def _of_table(place: Path) -> str:
    return content_hash(read_table(place))


def _of_report(place: Path) -> str:
    report = Report.load(place)
    tables = {"": report.table, **report.tables}
    statements = [
        sorted(report.summary.items()),
        [(name, content_hash(tables[name])) for name in sorted(tables)],
    ]
    return hashlib.sha256(repr(statements).encode()).hexdigest()


def _of_page(place: Path) -> str:
    """Return whether a page is complete; its sizes on disk may differ."""
    return "complete" if place.read_text("utf-8").rstrip().endswith("</html>") else "incomplete"


def compared(root: Path, expected: Mapping[str, str]) -> list[str]:
    """Return the tables and reports that have changed, and files that were left behind."""
    found = state(root)
    wrong = [f"{name}: {found[name]}" for name in expected if found[name] != expected[name]]
    return wrong + [f"{name} was left behind" for name in leftovers(root)]


def ended_early(
    place: Path, endings: int, rng: np.random.Generator
) -> Iterator[tuple[str, list[str]]]:
    """Interrupt assets at random moments of their step; yield each interruption and its faults."""
    expected, seconds = state(place / "data"), {}
    for number in range(endings):
        asset, how = KILLED[number % len(KILLED)], ENDINGS[number % len(ENDINGS)]
        if asset not in seconds:
            seconds[asset] = _seconds_of_step(place, asset)
        running = start(place, [asset])
        wait_for_step(place, running)
        time.sleep(rng.uniform(0.0, seconds[asset]))
        moment = "after its end" if running.poll() is not None else "in its step"
        wrong = end(running, how)
        found = compared(place / "data", expected)
        if how != "terminate":  # a killed process cannot tidy up; the next one does
            found = [each for each in found if "left behind" not in each]
        yield f"{asset}: {how}, {moment}", wrong + found
    for asset in KILLED:
        if start(place, [asset]).wait() != 0:
            yield asset, ["could not be materialized afterwards"]
    yield "all materialized again", compared(place / "data", expected)


def stopped_runs(place: Path, count: int, rng: np.random.Generator) -> Iterator[list[str]]:
    """Send SIGTERM while runs are simulated; yield the faults after each signal."""
    for number in range(count):
        run = RunDirectory(place / "data", RUNS[0][0], len(RUNS) + number)
        running = start(place, RUN_ASSETS, "--partition", run.key)
        wait_for_step(place, running)
        time.sleep(rng.uniform(0.0, LATEST_S))
        wrong = end(running, "terminate")
        if run.is_complete() and content_hash_of_bag(run.bag) != run.manifest().content_hash:
            wrong.append(f"{run.key} looks finished but is damaged")
        yield wrong + [f"{name} was left behind" for name in leftovers(run.root)]
        if start(place, RUN_ASSETS, "--partition", run.key).wait() != 0:
            yield [f"{run.key} could not be materialized afterwards"]
        shutil.rmtree(run.path)


def _seconds_of_step(place: Path, asset: str) -> float:
    """Return the duration of an asset's step [s]."""
    running = start(place, [asset])
    wait_for_step(place, running)
    began = time.monotonic()
    running.wait()
    return time.monotonic() - began


def main() -> None:
    """Interrupt assets many times, and print whether anything was lost or damaged."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.soak.aggregates", description=main.__doc__
    )
    parser.add_argument("--endings", type=int, default=21)
    parser.add_argument("--stops", type=int, default=5, help="SIGTERMs during a simulation")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    everything: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        make_campaign(place / "data")
        for done, wrong in ended_early(place, arguments.endings, rng):
            print(f"{done}: {'; '.join(wrong) or 'no faults'}", flush=True)
            everything += wrong
        for wrong in stopped_runs(place, arguments.stops, rng):
            print(f"a run stopped: {'; '.join(wrong) or 'no faults'}", flush=True)
            everything += wrong
    print("\n".join(everything) or "Nothing was lost or damaged.")
    sys.exit(bool(everything))


if __name__ == "__main__":
    main()
