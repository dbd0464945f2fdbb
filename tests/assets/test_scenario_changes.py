"""The sensor requests the runs of a mode once when its scenario changes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dagster as dg
import pytest
import yaml

from oracle_pipeline.definitions import defs
from sim.modes import FOLDER
from sim.scenarios import builtin_scenarios
from tests.assets.laboratory import Laboratory, dagster_home

RANGE = ("dagster/asset_partition_range_start", "dagster/asset_partition_range_end")


MODE = "held_upside_down"


@pytest.fixture
def scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of the user's with a mode in it."""
    folder = tmp_path / "scenarios"
    folder.mkdir()
    file = folder / "own.yaml"
    document = {**builtin_scenarios()["random_noise"].document, "id": MODE}
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    monkeypatch.setenv(FOLDER, str(folder))
    return file


def edit(file: Path, **changes: str) -> None:
    document = yaml.safe_load(file.read_text(encoding="utf-8"))
    file.write_text(yaml.safe_dump({**document, **changes}), encoding="utf-8")


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    """An instance in which some runs of two modes are materialized."""
    folder = tmp_path_factory.mktemp("watched")
    with dagster_home(folder / "home") as instance:
        laboratory = Laboratory(folder / "data", instance)
        for key in (f"{MODE}|run000", f"{MODE}|run001", f"{MODE}|run004", "fake_object|run000"):
            materialized(laboratory, key)
        yield laboratory


def materialized(laboratory: Laboratory, key: str) -> None:
    laboratory.instance.report_runless_asset_event(
        dg.AssetMaterialization("experiment_runs", partition=key)
    )


def tick(laboratory: Laboratory, cursor: str | None) -> Any:
    context = dg.build_sensor_context(instance=laboratory.instance, cursor=cursor)
    return defs.resolve_sensor_def("changed_scenarios").evaluate_tick(context)


def test_a_changed_scenario_requests_its_materialized_runs_once(
    watched: Laboratory, scenario: Path
) -> None:
    first = tick(watched, None)
    assert not first.run_requests
    edit(scenario, title="Another title")
    second = tick(watched, first.cursor)
    assert [tuple(r.tags[tag] for tag in RANGE) for r in second.run_requests] == [
        (f"{MODE}|run000", f"{MODE}|run001"),
        (f"{MODE}|run004", f"{MODE}|run004"),
    ]
    for request in second.run_requests:
        assert request.run_config["ops"]["runs"]["config"]["refresh"]
    keys = [request.run_key for request in second.run_requests]
    assert len(set(keys)) == len(keys)
    assert [r.run_key for r in tick(watched, first.cursor).run_requests] == keys  # a lost cursor
    third = tick(watched, second.cursor)
    assert not third.run_requests
    assert "reloaded" in third.skip_message


@pytest.mark.slow
def test_a_change_back_and_forth_is_requested_again(watched: Laboratory, scenario: Path) -> None:
    cursor, asked = tick(watched, None).cursor, []
    original = scenario.read_text(encoding="utf-8")
    for change in ("B", None, "B"):
        scenario.write_text(original, encoding="utf-8")
        if change:
            edit(scenario, title=change)
        seen = tick(watched, cursor)
        cursor = seen.cursor
        asked += [request.run_key for request in seen.run_requests]

        @dg.asset(
            name="experiment_runs", partitions_def=defs.resolve_assets_def("bags").partitions_def
        )
        def made() -> None: ...

        dg.materialize([made], partition_key="fake_object|run000", instance=watched.instance)
    assert len(asked) == len(set(asked)) == 6


def test_a_changed_layout_of_a_file_does_not_count(watched: Laboratory, scenario: Path) -> None:
    cursor = tick(watched, None).cursor
    scenario.write_text("# A comment.\n" + scenario.read_text(encoding="utf-8"), encoding="utf-8")
    assert not tick(watched, cursor).run_requests


def test_an_invalid_file_is_reported_and_requested_once_corrected(
    watched: Laboratory, scenario: Path
) -> None:
    cursor = tick(watched, None).cursor
    whole = scenario.read_text(encoding="utf-8")
    scenario.write_text(whole.replace("main:", "mian:"), encoding="utf-8")
    broken = tick(watched, cursor)
    assert not broken.run_requests
    assert str(scenario) in broken.skip_message
    scenario.write_text(whole, encoding="utf-8")
    edit(scenario, title="Another title")
    assert len(tick(watched, broken.cursor).run_requests) == 2


def test_a_changed_scenario_without_materialized_runs_requests_nothing(
    empty: Laboratory, scenario: Path
) -> None:
    cursor = tick(empty, None).cursor
    edit(scenario, title="Another title")
    seen = tick(empty, cursor)
    assert not seen.run_requests
    assert f"{MODE} has changed, but has no materialized run." in seen.skip_message
