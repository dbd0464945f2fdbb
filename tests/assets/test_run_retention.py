"""Old Dagster runs are deleted unless a partition still shows them."""

from pathlib import Path
from typing import Any

import dagster as dg
import pytest

from assets.run_retention import forget_old_runs
from tests.assets.laboratory import Laboratory


@dg.asset(partitions_def=dg.StaticPartitionsDefinition(["a", "b"]))
def by_letter(context: dg.AssetExecutionContext) -> None:
    """Two partitions."""


@dg.asset
def over_all() -> None:
    """One, over them."""


@dg.asset_check(asset=over_all)
def is_sound() -> dg.AssetCheckResult:
    return dg.AssetCheckResult(passed=True)


SMALL = dg.Definitions(
    assets=[by_letter, over_all], asset_checks=[is_sound], jobs=[forget_old_runs]
)


def small(laboratory: Laboratory, *assets: str, partition: str | None = None) -> str:
    job = SMALL.resolve_implicit_global_asset_job_def()
    done = job.execute_in_process(
        asset_selection=[dg.AssetKey(asset) for asset in assets],
        instance=laboratory.instance,
        partition_key=partition,
    )
    return done.run_id


def forget(laboratory: Laboratory, days: int) -> dict[str, Any]:
    done = SMALL.resolve_job_def("forget_old_runs").execute_in_process(
        instance=laboratory.instance,
        run_config={"ops": {"forget_runs": {"config": {"days": days}}}},
    )
    (output,) = [e for e in done.all_events if e.event_type_value == "STEP_OUTPUT"]
    return {name: value.value for name, value in output.step_output_data.metadata.items()}


@pytest.mark.slow
def test_old_runs_are_deleted_unless_they_hold_the_newest_state(empty: Laboratory) -> None:
    instance = empty.instance
    old = [small(empty, "by_letter", partition="b"), small(empty, "over_all")]
    in_use = [
        small(empty, "by_letter", partition="a"),
        small(empty, "by_letter", partition="b"),
        small(empty, "over_all"),
    ]
    started = dg.DagsterRunStatus.STARTED
    going_on = instance.create_run_for_job(forget_old_runs, status=started).run_id

    def seen() -> tuple[set[str], Any]:
        checks = instance.event_log_storage.get_asset_check_partition_info(
            [dg.AssetCheckKey(dg.AssetKey("over_all"), "is_sound")]
        )
        return instance.get_materialized_partitions(dg.AssetKey("by_letter")), checks

    before = seen()
    assert forget(empty, days=1) == {"forgotten": 0, "old_and_in_use": 0}
    assert all(instance.has_run(run) for run in old)
    deleted = forget(empty, days=0)
    assert deleted == {
        "forgotten": len(old) + 1,
        "old_and_in_use": len(in_use),
    }  # and the job's first
    assert not any(instance.has_run(run) for run in old)
    assert all(instance.has_run(run) for run in [*in_use, going_on])
    assert seen() == before
    assert before[0] == {"a", "b"}
    home = Path(instance.root_directory)
    assert not [path for run in old for path in home.rglob(f"*{run}*")]
