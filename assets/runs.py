"""The five assets of every run, from recipe to features, as one step.

A worker takes one run all the way, so that its bag is read while it is there (and can be dropped
before the next one comes), and so that a range of partitions needs one Dagster run. Why, and what
it costs: docs/dagster.md.
"""

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import dagster as dg
from pydantic import Field

from assets import presentation, terminal
from assets.common import OWNERS, SINGLE_RUN
from assets.events import materialization, no_further_event
from assets.partitions import RUNS
from assets.versions import feature_code
from resources.budget import StorageBudget
from resources.campaign import CampaignSettings
from resources.fleet import Fleet
from resources.store import RunStore
from sim.progress import RunProgress
from sim.software import software

if TYPE_CHECKING:
    from assets.worker import RunJob

EXPERIMENT_RUNS = dg.AssetSpec(
    "experiment_runs",
    group_name="simulation",
    kinds={"mujoco", "ros2"},
    owners=OWNERS,
    code_version=software().code,
    description="""One patrol of the robot in MuJoCo, normal or attacked, as its recipe says.

Run *i* of every mode has the same start, goals and nuisance (block *i*). The manifest holds
recipe, outcome, onset, contacts and hashes: `<root>/runs/<mode>/run003/manifest.json`.
The same recipe gives the same messages, byte for byte. The run from above is in the metadata and in
`picture.png`; `oracle-sim replay` makes a film of it.""",
)
BAGS = dg.AssetSpec(
    "bags",
    deps=[EXPERIMENT_RUNS],
    group_name="recording",
    kinds={"ros2", "mcap"},
    owners=OWNERS,
    code_version=software().code,
    description="""The run as a rosbag2: what `ros2 bag record -a` would have taken.

MCAP or sqlite3, compressed with zstd, in `<root>/runs/<mode>/run003/bag`. Its data version is a
hash over topics, types, stamps and payloads, the same wherever the run is made.""",
)
INTERVAL_GRAPHS = dg.AssetSpec(
    "interval_graphs",
    deps=[BAGS],
    group_name="recording",
    kinds={"networkx", "gexf"},
    owners=OWNERS,
    code_version=software().code,
    description="""The ROS graph of every 10 s of the recording, and of the whole run.

GEXF: ROS nodes and topics, an edge for each publisher and subscription with its messages and bytes
in the interval. In `<root>/runs/<mode>/run003/graphs`; opens in Gephi and NetworkX;
`full.gexf` is the whole run with services and actions.""",
)
WINDOW_FEATURES = dg.AssetSpec(
    "window_features",
    deps=[BAGS, INTERVAL_GRAPHS],
    group_name="features",
    kinds={"pandas", "parquet"},
    owners=OWNERS,
    code_version=feature_code(),
    description="""What all plugins say of each window of 10 s, every 5 s.

A row a window, from `window_start_s` of the recording; units in the schema. A feature that a
window does not give is empty, with the reason in column `missing`.""",
)
RUN_FEATURES = dg.AssetSpec(
    "run_features",
    deps=[BAGS, INTERVAL_GRAPHS],
    group_name="features",
    kinds={"pandas", "parquet"},
    owners=OWNERS,
    code_version=feature_code(),
    description="""What all plugins say of the whole run: one row.

Columns are named `<family>.<feature>`, units in the schema. Features never see label, mode,
onset, recipe or ground truth.""",
)
SHOWN = 20  # failed runs named in a failure's text; its metadata name all
SPECS = (EXPERIMENT_RUNS, BAGS, INTERVAL_GRAPHS, WINDOW_FEATURES, RUN_FEATURES)


class RunConfig(dg.Config):
    """How runs are made."""

    refresh: bool = Field(
        default=False,
        description="Make again what is there already; otherwise a complete run is verified only.",
    )


@dg.multi_asset(
    name="runs",
    specs=SPECS,
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
) -> Iterator[dg.AssetMaterialization | dg.Output[None]]:
    """Take every run of the partitions from recipe to features, block by block."""
    from assets.worker import process_run

    specs = [spec for spec in SPECS if spec.key in context.selected_asset_keys]
    keys = {str(key): key for key in context.partition_keys}
    jobs = [_job(key, specs, store, campaign, refresh=config.refresh) for key in keys]
    jobs.sort(key=lambda job: job.directory.run)  # so that paired modes finish together
    store.require_writable()
    budget.require_room(store, sum(not job.directory.is_complete() for job in jobs))

    failed: dict[str, str] = {}
    simulated = 0
    with contextlib.redirect_stderr(terminal.stderr()), RunProgress(len(jobs)) as progress:
        for outcome in fleet.outcomes(process_run, jobs):
            key = outcome.job.directory.key
            if outcome.result is None:
                failed[key] = outcome.error or "no reason was given"
                continue
            for spec in specs:
                made = outcome.result.assets[spec.key.to_user_string()]
                yield materialization(
                    context.instance,
                    spec,
                    keys[key],
                    data_version=made.version,
                    code_version=made.code,
                    metadata={
                        **presentation.facts(made.figures),
                        "path": dg.MetadataValue.path(made.path),
                    },
                )
            progress.done(outcome.result.simulated_s)
            simulated += outcome.result.simulated_s > 0.0
    verified = len(jobs) - simulated - len(failed)
    context.log.info(f"Runs: {simulated} simulated, {verified} verified, {len(failed)} failed.")
    if failed:
        raise _failure(failed, len(jobs))
    for spec in specs:
        yield no_further_event(spec.key.to_python_identifier())


def _job(
    key: str,
    specs: Sequence[dg.AssetSpec],
    store: RunStore,
    campaign: CampaignSettings,
    *,
    refresh: bool,
) -> "RunJob":
    from assets.worker import RunJob

    return RunJob(
        directory=store.run(key),
        campaign=campaign.campaign(),
        wanted=frozenset(spec.key.to_user_string() for spec in specs),
        refresh=refresh,
    )


def _failure(failed: dict[str, str], runs: int) -> dg.Failure:
    """Name the runs that failed, why, and what to do."""
    reasons = [f"{key}: {error.strip().splitlines()[-1]}" for key, error in sorted(failed.items())]
    kept = "; the finished ones are kept" if len(failed) < runs else ""
    return dg.Failure(
        f"{len(failed)} of {runs} runs failed{kept}. Materialize the same again when the "
        "cause is removed: what is finished is only verified. A damaged run alone is made again "
        "with `refresh: true` in the config of `runs`.\n" + "\n".join(reasons[:SHOWN]),
        metadata={"failed": dg.MetadataValue.json(failed)},
        allow_retries=False,
    )
