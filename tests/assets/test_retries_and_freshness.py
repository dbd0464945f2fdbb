"""Run retries and freshness, with the settings of dagster.yaml and the switch turned on."""

import asyncio
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import dagster as dg
import pytest
import yaml

from oracle_pipeline.definitions import defs
from tests.assets.dagster_internals import (
    LoadingContextForTest,
    TimeWindowFreshnessPolicyEvaluator,
    freeze_time,
)
from tests.assets.laboratory import Laboratory
from tests.instances import SETTINGS, instance_of

REPORT = dg.AssetKey("oracle_report")


@pytest.fixture
def switched_on(tmp_path: Path) -> Iterator[dg.DagsterInstance]:
    settings = yaml.safe_load(SETTINGS.read_text(encoding="utf-8"))
    for part in ("run_retries", "freshness"):
        settings[part]["enabled"] = True
    home = tmp_path / "on"
    home.mkdir()
    (home / "dagster.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    with instance_of(home) as instance:
        yield instance


@dg.op
def fails() -> None:
    raise dg.Failure("The experiment went wrong.")


@dg.job
def failing() -> None:
    fails()


@pytest.mark.slow
def test_a_run_whose_process_died_is_retried_once_and_one_that_failed_is_not(
    switched_on: dg.DagsterInstance,
) -> None:
    died = switched_on.create_run_for_job(failing, status=dg.DagsterRunStatus.STARTED)
    switched_on.report_run_failed(died)
    failed = failing.execute_in_process(instance=switched_on, raise_on_error=False).run_id

    def will_be_retried(run_id: str) -> str:
        run = switched_on.get_run_by_id(run_id)
        assert run is not None
        return run.tags["dagster/will_retry"]

    assert will_be_retried(died.run_id) == "true"
    assert will_be_retried(failed) == "false"
    again = switched_on.create_run_for_job(
        failing,
        status=dg.DagsterRunStatus.STARTED,
        root_run_id=died.run_id,
        parent_run_id=died.run_id,
        tags={"dagster/root_run_id": died.run_id, "dagster/parent_run_id": died.run_id},
    )
    switched_on.report_run_failed(again)
    assert will_be_retried(again.run_id) == "false"


@pytest.mark.slow
def test_a_report_is_stale_after_a_night_and_a_half_and_too_old_after_another(
    switched_on: dg.DagsterInstance, empty: Laboratory
) -> None:
    assert "FRESHNESS_DAEMON" in switched_on.get_required_daemon_types()
    assert "FRESHNESS_DAEMON" not in empty.instance.get_required_daemon_types()
    switched_on.report_runless_asset_event(dg.AssetMaterialization(REPORT))
    node = defs.resolve_asset_graph().get(REPORT)

    def after(hours: float) -> str:
        with freeze_time(datetime.now(UTC) + timedelta(hours=hours)):
            state = TimeWindowFreshnessPolicyEvaluator().evaluate_freshness(
                LoadingContextForTest(switched_on), node
            )
            return asyncio.run(state).name

    assert [after(hours) for hours in (1, 35, 37, 59, 61)] == [
        "PASS", "PASS", "WARN", "WARN", "FAIL"
    ]  # fmt: skip
