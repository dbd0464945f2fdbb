"""Deletes Dagster's records of old runs that no partition needs any more.

Dagster deletes old ticks by itself (``retention`` in dagster.yaml), but never runs. Deleting a run
deletes its materializations too, so a run is kept while it has the newest materialization or check
of any partition. Recordings and reports below the root of the store are never deleted.
"""

from collections.abc import Collection
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path

import dagster as dg
from pydantic import Field

_ENDED = (dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED)
_BATCH = 500  # events read at a time


class RetentionConfig(dg.Config):
    """The age from which runs are deleted."""

    days: int = Field(default=30, ge=0, description="Delete runs that ended longer ago [days].")


@dg.op
def forget_runs(context: dg.OpExecutionContext, config: RetentionConfig) -> None:
    """Delete records, events and console logs of Dagster runs that ended long ago."""
    instance = context.instance
    before = datetime.now(UTC) - timedelta(days=config.days)
    ended = [
        run.run_id
        for run in instance.get_runs(dg.RunsFilter(statuses=_ENDED, updated_before=before))
    ]
    in_use = _runs_in_use(instance, _checks_of(instance, ended))
    unused = [run for run in ended if run not in in_use]
    for run in unused:
        _delete(instance, run)
    context.log.info(
        f"Deleted the records of {len(unused)} Dagster runs that ended more than {config.days} "
        f"days ago; kept {len(ended) - len(unused)} with the newest state of a partition."
    )
    context.add_output_metadata(
        {"forgotten": len(unused), "old_and_in_use": len(ended) - len(unused)}
    )


@dg.job(description="Delete records of old Dagster runs; never recordings or reports.")
def forget_old_runs() -> None:
    """Delete old Dagster runs."""
    forget_runs()


weekly = dg.ScheduleDefinition(
    name="weekly",
    job=forget_old_runs,
    cron_schedule="0 6 * * 0",
    default_status=dg.DefaultScheduleStatus.STOPPED,
    description="Every Sunday: delete records of old Dagster runs.",
)


def _checks_of(instance: dg.DagsterInstance, runs: Collection[str]) -> set[dg.AssetCheckKey]:
    """Return the checks that were planned in runs."""
    planned = dg.DagsterEventType.ASSET_CHECK_EVALUATION_PLANNED
    return {
        event.get_dagster_event().asset_check_planned_data.asset_check_key
        for run in runs
        for event in instance.all_logs(run, of_type=planned)
    }


def _runs_in_use(instance: dg.DagsterInstance, checks: Collection[dg.AssetCheckKey]) -> set[str]:
    """Return the runs with the newest materialization or check result of any partition."""
    in_use = set()
    for asset in instance.all_asset_keys():
        if latest := instance.get_latest_materialization_event(asset):
            in_use.add(latest.run_id)
        newest = instance.get_latest_storage_id_by_partition(
            asset, dg.DagsterEventType.ASSET_MATERIALIZATION
        )
        events = iter(newest.values())
        while batch := list(islice(events, _BATCH)):
            wanted = dg.AssetRecordsFilter(asset_key=asset, storage_ids=batch)
            records = instance.fetch_materializations(wanted, limit=len(batch)).records
            in_use |= {record.run_id for record in records}
    results = instance.event_log_storage.get_asset_check_partition_info(list(checks))
    return in_use | {result.latest_planned_run_id for result in results}


def _delete(instance: dg.DagsterInstance, run: str) -> None:
    instance.delete_run(run)
    instance.compute_log_manager.delete_logs(prefix=[run])
    # With SQLite, each run has its own database file. Dagster empties it but leaves the file.
    path_of_run = getattr(instance.event_log_storage, "path_for_shard", None)
    if path_of_run is not None:
        file = Path(path_of_run(run))
        for part in file.parent.glob(f"{file.name}*"):
            part.unlink(missing_ok=True)
