"""The five assets of every run, from recipe to features, as one step.

A worker processes one run completely before the next: features are extracted right after recording,
so that the bag can be dropped, and any range of partitions is one Dagster run.
docs/explanation/dagster.md explains the reasons and costs.
"""

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.asset_defaults import SINGLE_RUN, declared
from assets.events import Materialized, check_evaluation, latest_materialization, materializations
from assets.partition_work import PartitionWork
from assets.partitions import RUNS
from assets.worker.versions import feature_code
from oracle_pipeline.bags import layout
from resources.budget import StorageBudget
from resources.campaign import CampaignSettings
from resources.dagster_internals import output_without_event
from resources.fleet import Fleet, in_words
from resources.store import RunStore
from sim.commands.progress import RunProgress
from sim.modes import left_out
from sim.software import run_code
from sim.testbeds import TESTBEDS

if TYPE_CHECKING:
    from assets.worker.run_job import RunJob, RunReport
    from sim.experiments import RebuildResult
    from sim.fan_out import JobOutcome

# The terminal of progress bars: inside a step, Dagster redirects standard error to a log file.
_TERMINAL = os.fdopen(os.dup(sys.stderr.fileno()), "w") if sys.stderr.isatty() else None

_RUN_CODE = run_code(testbed.made_by for testbed in TESTBEDS.values())
_CURRENT = frozenset(run_code([testbed.made_by]) for testbed in TESTBEDS.values())

EXPERIMENT_RUNS = dg.AssetSpec(
    "experiment_runs",
    group_name="simulation",
    kinds={"mujoco", "ros2"},
    **declared("run", "runs/<mode>/<run>"),
    code_version=_RUN_CODE,
    description="""A run of a testbed, normal or attacked, such as a patrol of the robot in MuJoCo.

Run *i* of every mode of a testbed has the same task and nuisance (block *i*).
`<root>/runs/<mode>/run003/manifest.json` holds recipe, outcome, onset, changes made by the attack,
contacts and hashes. The same recipe gives the same messages, byte for byte. A picture of the run is
in the metadata and in `picture.png`; `oracle replay` makes a film.""",
)
BAGS = dg.AssetSpec(
    "bags",
    deps=[EXPERIMENT_RUNS],
    group_name="recording",
    kinds={"ros2", "mcap"},
    **declared("run", "runs/<mode>/<run>/bag"),
    code_version=_RUN_CODE,
    description="""The run as a rosbag2, as `ros2 bag record -a` would record it.

MCAP or sqlite3, compressed with zstd, in `<root>/runs/<mode>/run003/bag`. Its data version is a
hash over topics, types, stamps and payloads, the same on every machine.""",
)
INTERVAL_GRAPHS = dg.AssetSpec(
    "interval_graphs",
    deps=[BAGS],
    group_name="recording",
    kinds={"networkx", "gexf"},
    **declared("run", "runs/<mode>/<run>/graphs"),
    code_version=_RUN_CODE,
    description="""The ROS graph of every 10 s of the recording, and of the whole run.

GEXF files in `<root>/runs/<mode>/run003/graphs`, for Gephi and NetworkX. Vertices are ROS nodes and
topics; each publisher and subscription is an edge with its messages and bytes in the interval.
`full.gexf` is the whole run with services and actions.""",
)
WINDOW_FEATURES = dg.AssetSpec(
    "window_features",
    deps=[BAGS, INTERVAL_GRAPHS],
    group_name="features",
    kinds={"pandas", "parquet"},
    **declared("run", "features/window/<mode>/<run>.parquet"),
    code_version=feature_code(),
    description="""The features of each window of 5 s, every 2.5 s, from all plugins.

One row for each window, by its start `window_start_s` in the recording; units in the schema. A
feature that cannot be computed for a window is empty, with the reason in column `missing`.""",
)
RUN_FEATURES = dg.AssetSpec(
    "run_features",
    deps=[BAGS, INTERVAL_GRAPHS],
    group_name="features",
    kinds={"pandas", "parquet"},
    **declared("run", "features/run/<mode>/<run>.parquet"),
    code_version=feature_code(),
    description="""The features of the whole run, from all plugins, in one row.

Columns are named `<family>.<feature>`, units in the schema. Features never see label, mode,
onset, recipe or ground truth.""",
)
_DESCRIPTIONS: Mapping["RebuildResult", str] = {
    "same messages": "Re-simulated: the messages are the same.",
    "other software": "Replaced: the code, a library or the CPU has changed.",
    "other recipe": "Replaced: the recipe has changed.",
    "not deterministic": "Replaced: no two runs of this testbed are alike.",
    "unexplained": "Re-simulation gave different messages although code, libraries, CPU and "
    "recipe are the same. Both runs are kept; the previous one stays in use.",
}
RUNS_DONE = "runs done"
SHOWN = 20  # most failed runs named in a failure's text; the metadata has all
SPECS = (EXPERIMENT_RUNS, BAGS, INTERVAL_GRAPHS, WINDOW_FEATURES, RUN_FEATURES)
REPRODUCIBLE = dg.AssetCheckSpec(
    "run_is_reproducible",
    asset=EXPERIMENT_RUNS.key,
    partitions_def=RUNS,
    description="Re-simulated with `refresh: true`, a run has the same messages unless its "
    "software or recipe has changed. A run that is only verified gives no result.",
)


class RunConfig(dg.Config):
    """Whether complete runs are verified or re-simulated."""

    refresh: bool = Field(
        default=False,
        description="Re-simulate complete runs and compare them with the previous ones; by "
        "default, a complete run is only verified.",
    )


@dg.multi_asset(
    name="runs",
    specs=SPECS,
    check_specs=[REPRODUCIBLE],
    partitions_def=RUNS,
    can_subset=True,
    backfill_policy=SINGLE_RUN,
)
def recorded_runs(
    context: dg.AssetExecutionContext,
    config: RunConfig,
    store: RunStore,
    fleet: Fleet,
    campaign: CampaignSettings,
    budget: StorageBudget,
) -> Iterator[dg.AssetMaterialization | dg.AssetCheckEvaluation | dg.Output[None]]:
    """Process every run of the partitions from recipe to features, block by block."""
    from assets.worker.run_job import RunJob

    for broken in left_out():
        context.log.warning(f"Left out: {broken}")
    specs = [spec for spec in SPECS if spec.key in context.selected_asset_keys]
    is_compared = REPRODUCIBLE.key in context.selected_asset_check_keys
    keys = {str(key): key for key in context.partition_keys}
    partitions = {key: PartitionWork(key, store.runs(key)) for key in keys}
    of_run = {run: partition for partition in partitions.values() for run in partition.runs}
    wanted = frozenset(spec.key.to_user_string() for spec in specs)
    jobs = [RunJob(run, campaign.campaign(), wanted, config.refresh) for run in of_run]
    jobs.sort(key=lambda job: job.directory.run)  # so that paired modes finish together
    store.require_writable()

    failed: dict[str, str] = {}
    simulated, simulated_s, open_partitions, started = 0, 0.0, len(keys), time.monotonic()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stderr(_TERMINAL or sys.stderr))
        progress = stack.enter_context(contextlib.closing(RunProgress(len(jobs))))
        if config.refresh or not all(job.directory.is_complete() for job in jobs):
            stack.enter_context(budget.alone(store))
        together = max(len(partition.runs) for partition in partitions.values())
        for outcome in _outcomes(jobs, store, fleet, budget, together):
            run = outcome.job.directory
            if outcome.result is not None and not outcome.job.wanted:
                freed = {"kept": outcome.result.kept, "freed_bytes": outcome.result.freed_bytes}
                context.log_event(dg.AssetObservation("bags", partition=run.key, metadata=freed))
                continue
            partition = of_run.get(run)
            if outcome.result is None:
                failed[run.key] = outcome.error or "no reason was given"
            else:
                progress.done(outcome.result.simulated_s)
                simulated += outcome.result.simulated_s > 0.0
                simulated_s += outcome.result.simulated_s
            if partition is None or not partition.add(run, outcome.result):
                continue
            open_partitions -= 1
            if partition.reports:
                assets = _materialized(specs, store, partition, last=not open_partitions)
                yield from materializations(context.instance, keys[partition.key], assets)
                if is_compared and partition.reproductions:
                    yield _reproducible(context, partition)
    context.log.info(
        f"{simulated} runs simulated ({in_words(simulated_s)} of the robot's time in "
        f"{in_words(time.monotonic() - started)}), {len(jobs) - simulated - len(failed)} verified, "
        f"{len(failed)} failed. They are in {store.path / layout.RUNS}. The job `report` analyses "
        "all runs in that folder."
    )
    if failed:
        raise _failure(failed, len(jobs))
    for spec in specs:
        yield output_without_event(spec.key.to_python_identifier())
    if is_compared:
        yield dg.Output(None, output_name=REPRODUCIBLE.get_python_identifier())


def _outcomes(
    jobs: Sequence["RunJob"], store: RunStore, fleet: Fleet, budget: StorageBudget, together: int
) -> Iterator["JobOutcome[RunJob, RunReport]"]:
    """Process the jobs block by block; the storage plan is updated as sizes become known.

    Finished runs that must free storage for others are processed first.
    """
    from assets.worker.run import process_run
    from assets.worker.run_job import RunJob

    log = dg.get_dagster_logger("oracle")
    waiting = list(jobs)
    while waiting:
        plan = budget.plan(
            store,
            [job.directory for job in waiting],
            workers=fleet.workers,
            goals=waiting[0].campaign.goals_per_run,
            together=together,
        )
        if plan is None:
            yield from fleet.outcomes(process_run, waiting, RUNS_DONE)
            return
        log.info(f"Storage: {plan}.")
        blocks = sorted({job.directory.run for job in waiting})[: plan.blocks_ahead]
        batch = [job for job in waiting if job.directory.run in blocks]
        waiting = waiting[len(batch) :]
        to_shrink = [
            RunJob(run, jobs[0].campaign, frozenset(), refresh=False, keep=plan.kept[run.run])
            for run in plan.shrink
        ]
        planned = [replace(job, keep=plan.kept[job.directory.run]) for job in batch]
        yield from fleet.outcomes(process_run, [*to_shrink, *planned], RUNS_DONE)


def _materialized(
    specs: Sequence[dg.AssetSpec], store: RunStore, partition: PartitionWork, *, last: bool
) -> Iterator[Materialized]:
    """Yield the materializations of the assets of a partition.

    Only the tables of the step's last one have a column schema. The UI shows the newest event, and
    60 kB for each table of each partition would make the event log slow.
    """
    assets = partition.assets()
    for spec in specs:
        made = assets[spec.key.to_user_string()]
        place = store.path / made.path
        figures = {**presentation.facts(made.figures), "path": dg.MetadataValue.path(str(place))}
        if last and place.suffix == ".parquet":
            figures["dagster/column_schema"] = dg.MetadataValue.table_schema(
                presentation.columns_of(place)
            )
        # An asset has one version for the runs of all testbeds, a run that of its own testbed.
        code = str(spec.code_version) if made.code in _CURRENT else made.code
        yield Materialized(spec, made.version, code, figures)


def _reproducible(
    context: dg.AssetExecutionContext, partition: PartitionWork
) -> dg.AssetCheckEvaluation:
    """Return the result of the partition: that of its first run with other messages, or of one."""
    from assets.worker.reproduction import refreshed_directory

    reproductions = partition.reproductions
    wrong = [run for run, of in reproductions.items() if of.comparison == "unexplained"]
    run = wrong[0] if wrong else next(iter(reproductions))
    reproduction = reproductions[run]
    facts: dict[str, dg.MetadataValue] = {
        "former_hash": dg.MetadataValue.text(reproduction.former_hash),
        "new_hash": dg.MetadataValue.text(reproduction.new_hash),
    }
    if len(reproductions) > 1:
        named = ", ".join(each.key for each in wrong)
        facts |= presentation.facts({"runs": len(reproductions), "unexplained": named})
    if wrong:
        facts |= {
            "former_path": dg.MetadataValue.path(str(run.path)),
            "new_path": dg.MetadataValue.path(str(refreshed_directory(run).path)),
        }
    return check_evaluation(
        REPRODUCIBLE,
        partition.key,
        latest_materialization(context.instance, REPRODUCIBLE.asset_key, partition.key),
        passed=not wrong,
        description=_DESCRIPTIONS[reproduction.comparison],
        metadata=facts,
    )


def _failure(failed: dict[str, str], runs: int) -> dg.Failure:
    """Return a failure that names the failed runs, the reasons and the remedy."""
    reasons = [f"{key}: {error.strip().splitlines()[-1]}" for key, error in sorted(failed.items())]
    kept = "; the finished ones are kept" if len(failed) < runs else ""
    return dg.Failure(
        f"{len(failed)} of {runs} runs failed{kept}. Fix the cause and materialize the same "
        "partitions again: finished runs are only verified. To re-simulate a damaged run, "
        "materialize it with `refresh: true` in the config of `runs`.\n"
        + "\n".join(reasons[:SHOWN]),
        metadata={"failed": dg.MetadataValue.json(failed)},
        allow_retries=False,
    )
