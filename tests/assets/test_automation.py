"""Schedules and sensors are off until they are switched on."""

from datetime import UTC, datetime, timedelta

import dagster as dg
import pytest

from assets.foreign_recordings import IS_NORMAL
from oracle_pipeline.definitions import defs
from sim.modes import modes
from tests.assets.laboratory import Laboratory

RANGE = ("dagster/asset_partition_range_start", "dagster/asset_partition_range_end")


def test_all_automation_is_off_by_default(empty: Laboratory) -> None:
    schedules = {schedule.name: schedule for schedule in defs.schedules or []}
    sensors = {sensor.name: sensor for sensor in defs.sensors or []}
    assert set(schedules) == {"nightly"}
    assert set(sensors) == {"arrived_recordings"}
    for schedule in schedules.values():
        assert schedule.default_status == dg.DefaultScheduleStatus.STOPPED
    for sensor in sensors.values():
        assert sensor.default_status == dg.DefaultSensorStatus.STOPPED
    assert not empty.instance.run_retries_enabled
    assert not empty.instance.freshness_enabled


def test_the_job_takes_every_asset_and_check_but_those_of_arrived_recordings() -> None:
    job, graph = defs.resolve_job_def("everything"), defs.resolve_asset_graph()
    assert job.asset_layer.executable_asset_keys == graph.materializable_asset_keys
    checks = {key for key in graph.asset_check_keys if key != IS_NORMAL.key}
    assert job.asset_layer.asset_graph.asset_check_keys == checks


@pytest.mark.slow
def test_as_many_nights_as_runs_re_simulate_every_run_once(empty: Laboratory) -> None:
    nightly = defs.resolve_schedule_def("nightly")
    first, *_, last = modes()
    ranges = set()
    for night in range(15):
        context = dg.build_schedule_context(
            instance=empty.instance,
            scheduled_execution_time=datetime(2026, 11, 25, 2, tzinfo=UTC) + timedelta(days=night),
        )
        (request,) = nightly.evaluate_tick(context).run_requests or []
        assert request.run_config == {"ops": {"runs": {"config": {"refresh": True}}}}
        ranges.add(tuple(request.tags[tag] for tag in RANGE))
    assert ranges == {(f"{first}|run{i:03d}", f"{last}|run{i:03d}") for i in range(15)}
