"""A job for each purpose, and the nightly schedule that re-simulates one block.

All automation is off by default. docs/how-to/automation.md explains how to use it.
"""

import dagster as dg

from assets import thesis_method
from assets.experiment_runs import RUN_FEATURES, SPECS, WINDOW_FEATURES
from assets.feature_dataset import feature_dataset
from assets.oracle_evaluation import oracle_evaluation
from assets.partitions import RUNS

THESIS = (
    thesis_method.bootstrapped_dataset,
    thesis_method.clustering_grid_search,
    thesis_method.malicious_rate_report,
    thesis_method.pairwise_report,
)

everything = dg.define_asset_job(
    "everything",
    selection="*",
    description="All assets, from the runs of the chosen partitions to the report over all runs.",
)
simulate = dg.define_asset_job(
    "simulate",
    selection=[spec.key for spec in SPECS],
    description="Record the runs of the chosen partitions and compute their features.",
)
features = dg.define_asset_job(
    "features",
    selection=[WINDOW_FEATURES.key, RUN_FEATURES.key],
    description="Extract the features of the chosen partitions again, for example after a plugin "
    "has changed. A missing run is recorded first.",
)
report = dg.define_asset_job(
    "report",
    selection=dg.AssetSelection.assets(feature_dataset).downstream(),
    description="Analyse all recorded runs and write the report; nothing is simulated.",
)
evaluate = dg.define_asset_job(
    "evaluate",
    selection=[feature_dataset, oracle_evaluation],
    description="Measure how well the oracle separates the attacked from the normal runs on disk.",
)
thesis = dg.define_asset_job(
    "thesis",
    selection=[feature_dataset, *THESIS],
    description="Repeat the thesis's method on the recorded runs.",
)
JOBS = (everything, simulate, features, report, evaluate, thesis)


@dg.schedule(
    job=everything,
    cron_schedule="0 2 * * *",
    default_status=dg.DefaultScheduleStatus.STOPPED,
    description="Every night: re-simulate one block (one run of every mode), compare it with "
    "the previous runs, and update the report. The block changes every night.",
)
def nightly(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    """Request the block of the day, in all modes."""
    modes, runs = (
        RUNS.get_partitions_def_for_dimension(name).get_partition_keys() for name in ("mode", "run")
    )
    run = runs[context.scheduled_execution_time.toordinal() % len(runs)]
    return dg.RunRequest(
        run_config={"ops": {"runs": {"config": {"refresh": True}}}},
        tags={
            "dagster/asset_partition_range_start": f"{modes[0]}|{run}",
            "dagster/asset_partition_range_end": f"{modes[-1]}|{run}",
        },
    )
