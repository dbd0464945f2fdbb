"""What can start by itself: the job over all assets, and the schedule that makes runs again.

Everything is off until somebody switches it on. The sensor is in ``assets.scenario_changes``, the
job that forgets old Dagster runs in ``assets.run_retention``. How to use them:
docs/how-to/automation.md.
"""

import dagster as dg

from assets.partitions import RUNS

everything = dg.define_asset_job(
    "everything",
    selection="*",
    description="All assets, from the runs of the chosen partitions to the report over all runs.",
)


def refreshed_runs(first: str, last: str, run_key: str | None = None) -> dg.RunRequest:
    """Ask for a range of partitions, simulated again: one Dagster run, not one a partition."""
    return dg.RunRequest(
        run_key=run_key,
        run_config={"ops": {"runs": {"config": {"refresh": True}}}},
        tags={
            "dagster/asset_partition_range_start": first,
            "dagster/asset_partition_range_end": last,
        },
    )


@dg.schedule(
    job=everything,
    cron_schedule="0 2 * * *",
    default_status=dg.DefaultScheduleStatus.STOPPED,
    description="Every night: make one run of every mode again, compare, and report anew. "
    "Runs take turns.",
)
def nightly(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    """Ask for the block whose turn it is, in all modes."""
    modes, runs = (
        RUNS.get_partitions_def_for_dimension(name).get_partition_keys() for name in ("mode", "run")
    )
    run = runs[context.scheduled_execution_time.toordinal() % len(runs)]
    return refreshed_runs(f"{modes[0]}|{run}", f"{modes[-1]}|{run}")
