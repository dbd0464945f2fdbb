"""The one job and its schedule. Nothing starts by itself: the schedule is off until switched on."""

import dagster as dg

from assets.partitions import RUNS

everything = dg.define_asset_job(
    "everything",
    selection="*",
    description="All assets, from the runs of the chosen partitions to the report over all runs.",
)


@dg.schedule(
    job=everything,
    cron_schedule="0 2 * * *",
    default_status=dg.DefaultScheduleStatus.STOPPED,
    description="Every night: verify every run of every mode, make what is missing, report anew.",
)
def nightly() -> dg.RunRequest:
    """Ask for all partitions as one range: one Dagster run, not one a partition."""
    return dg.RunRequest(
        tags={
            "dagster/asset_partition_range_start": str(RUNS.get_first_partition_key()),
            "dagster/asset_partition_range_end": str(RUNS.get_last_partition_key()),
        }
    )
