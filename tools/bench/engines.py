"""Speed of executors: one process against two, and a Dask cluster against a process pool.

A job takes one run from recipe to features, as in the product. Each measurement is the time from
the first job to the last outcome. Workers have done such a job before, so the start of processes
does not count. Rounds alternate, so that other load on the machine affects all alternatives alike.
The yardstick also measures how much faster two independent processes are on this machine.
"""

import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path

from distributed import LocalCluster

from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.cluster import PATIENCE_S, DaskExecutor
from sim.campaigns import Campaign
from sim.fan_out import process_pool
from tools.bench import yardstick
from tools.bench.figures import Row, median, spread

MODE = "lidar_passthrough_odom"
GOALS = 1
JOBS = 16  # per round; one of two workers idles for half a job on average at the end
ROUNDS = 3
PHYSICS_S = 100.0  # simulated time of one job of the yardstick


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as engines:
        cluster = engines.enter_context(
            LocalCluster(
                n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
                memory_limit=0, local_directory=folder,
            )
        )  # fmt: skip
        executors = {
            "one": engines.enter_context(process_pool(1)),
            "two": engines.enter_context(process_pool(2)),
            "dask": engines.enter_context(DaskExecutor(cluster.scheduler_address, PATIENCE_S)),
        }
        for number, executor in enumerate(executors.values()):  # compiles and imports
            _seconds(executor, Path(folder, f"warm_up_{number}"), 2)
        seconds: dict[str, list[float]] = {name: [] for name in executors}
        physics: dict[str, list[float]] = {"one": [], "two": []}
        for number in range(ROUNDS):
            for name, executor in executors.items():
                root = Path(folder, f"{name}_{number}")
                seconds[name].append(_seconds(executor, root, JOBS))
            for name, measured in physics.items():
                measured.append(_physics_seconds(executors[name]))
        yield from _ratios(seconds, physics)


def _seconds(executor: Executor, root: Path, jobs: int) -> float:
    """Return the time that new runs take [s]."""
    started = time.perf_counter()
    list(executor.map(_run, [root] * jobs, range(jobs)))
    return time.perf_counter() - started


def _physics_seconds(executor: Executor) -> float:
    """Return the time that the yardstick takes [s]."""
    started = time.perf_counter()
    list(executor.map(yardstick.run, [PHYSICS_S] * JOBS))
    return time.perf_counter() - started


def _run(root: Path, number: int) -> None:
    """Take one run from recipe to features."""
    campaign = Campaign(goals_per_run=GOALS)
    process_run(RunJob(RunDirectory(root, MODE, number), campaign, OF_A_RUN, refresh=False))


def _ratios(seconds: dict[str, list[float]], physics: dict[str, list[float]]) -> Iterator[Row]:
    scaling, of_machine = _scaling(seconds), _scaling(physics)
    against = [dask / two for dask, two in zip(seconds["dask"], seconds["two"], strict=True)]
    yield Row("runs per minute, one process", _a_minute(seconds["one"]), "")
    yield Row("runs per minute, two processes", _a_minute(seconds["two"]), "")
    yield Row("two processes against one", median(scaling), "x", 1.8, False, spread(scaling))
    yield Row("  of the yardstick", median(of_machine), "x", remark=spread(of_machine))
    yield Row("Dask against the pool, time", median(against), "x", 1.1, True, spread(against))


def _scaling(seconds: dict[str, list[float]]) -> list[float]:
    return [one / two for one, two in zip(seconds["one"], seconds["two"], strict=True)]


def _a_minute(seconds: list[float]) -> float:
    return JOBS / median(seconds) * 60
