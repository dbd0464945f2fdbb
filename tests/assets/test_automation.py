"""The schedule: off until somebody turns it on, and one Dagster run for all partitions."""

import dagster as dg

from oracle_pipeline.definitions import defs
from sim.modes import modes
from tests.assets.laboratory import Laboratory


def test_nothing_starts_by_itself() -> None:
    schedules = list(defs.schedules or [])
    assert [schedule.name for schedule in schedules] == ["nightly"]
    assert schedules[0].default_status == dg.DefaultScheduleStatus.STOPPED
    assert not defs.sensors


def test_a_night_is_one_run_over_the_whole_grid(empty: Laboratory) -> None:
    nightly = defs.resolve_schedule_def("nightly")
    tick = nightly.evaluate_tick(dg.build_schedule_context(instance=empty.instance))
    (request,) = tick.run_requests
    first, *_, last = modes()
    assert request.tags["dagster/asset_partition_range_start"] == f"{first}|run000"
    assert request.tags["dagster/asset_partition_range_end"] == f"{last}|run014"


def test_the_job_takes_every_asset_and_check() -> None:
    job, graph = defs.resolve_job_def("everything"), defs.resolve_asset_graph()
    assert job.asset_layer.executable_asset_keys == graph.materializable_asset_keys
    assert job.asset_layer.asset_graph.asset_check_keys == graph.asset_check_keys
