"""Wall time of a whole campaign in Dagster that is not its pure work, for each run.

Pure work is the time that each run reports for its simulation and its features, plus the time of
each step over all runs, on all cores. Wall time is that of the command
``dagster asset materialize``. The difference is start-up, planning, images of the runs, events,
checks, and steps that use one core. It is given in seconds: over the pure work, it would grow when
simulation or features become faster.
"""

import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import dagster as dg

from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from tools.bench.figures import Row
from tools.soak.budget import MODES, campaign

RUNS = 20  # per mode
# For each run of one goal: what 1.3 times the pure work allowed when that was the goal. 120 such
# runs had 186 s of it on 2 cores.
GOAL_S = 0.47
# Goals per run: default patrols, and the shortest, where overhead weighs most.
CAMPAIGNS = {Campaign().goals_per_run: None, 1: GOAL_S}
MOST = 10_000  # events in one page of Dagster's
TIMED = ("experiment_runs", "run_features")  # assets of a run that record their duration
OF_RUNS = ("runs", "checks_of_runs")  # steps whose work is done in worker processes


def rows() -> Iterator[Row]:
    """Yield the figures."""
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as folder:
        _warm_up(Path(folder))
    for goals, goal_s in CAMPAIGNS.items():
        with tempfile.TemporaryDirectory() as folder:
            home = Path(folder)
            started = time.perf_counter()
            running = campaign(home, RUNS, goals, stdout=subprocess.DEVNULL)
            if running.wait() != 0:
                raise RuntimeError(f"The campaign of {RUNS} runs per mode failed.")
            wall_s = time.perf_counter() - started
            of_runs_s, of_all_s = _pure_seconds(home / "dagster")
        name = f"campaign of {MODES * RUNS} runs, goals per run: {goals}"
        pure_s = (of_runs_s + of_all_s) / cores
        beside_s = (wall_s - pure_s) / (MODES * RUNS)
        yield Row(f"{name}: beside work", beside_s, "s", goal_s, True, f"a run ({cores} cores)")
        yield Row("  wall", wall_s, "s", remark=f"({wall_s / pure_s:.3g} times the pure work)")
        yield Row("  simulations and features, summed", of_runs_s, "s")
        yield Row("  tables, evaluation and reports, summed", of_all_s, "s")


def _warm_up(root: Path) -> None:
    """Compile everything that a run needs."""
    for mode in ("random_noise", "delayed_fakeobject"):
        run = RunDirectory(root, mode, 0)
        process_run(RunJob(run, Campaign(goals_per_run=1), OF_A_RUN, refresh=False))


def _pure_seconds(dagster_home: Path) -> tuple[float, float]:
    """Return the seconds of work of all runs, and of the steps over all runs."""
    os.environ["DAGSTER_HOME"] = str(dagster_home)  # which its settings name
    with dg.DagsterInstance.get() as instance:
        of_runs_s = 0.0
        for asset in TIMED:
            records = instance.fetch_materializations(dg.AssetKey(asset), limit=MOST).records
            made = [record.asset_materialization for record in records]
            of_runs_s += sum(float(str(each.metadata["wall_s"].value)) for each in made if each)
        (run,) = instance.get_runs()
        steps = instance.get_run_step_stats(run.run_id)
    of_all_s = sum(
        (step.end_time or 0.0) - (step.start_time or 0.0)
        for step in steps
        if step.step_key not in OF_RUNS
    )
    return of_runs_s, of_all_s
