"""What can start by itself: off until switched on, and then just what it says."""

import asyncio
import dataclasses
import json
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import dagster as dg
import pytest
import yaml
from dagster._core.definitions.freshness_evaluator import TimeWindowFreshnessPolicyEvaluator
from dagster._core.loader import LoadingContextForTest
from dagster._core.storage.tags import PARENT_RUN_ID_TAG, ROOT_RUN_ID_TAG, WILL_RETRY_TAG
from dagster._core.test_utils import freeze_time

from assets.automation import made_again
from assets.run_retention import forget_old_runs
from assets.runs import REPRODUCIBLE
from assets.worker.reproduction import judge, place_aside
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.definitions import defs
from sim.fuzzing.scenario import builtin_scenarios
from sim.modes import FOLDER, modes
from tests.assets.laboratory import KEYS, PER_RUN, ROOT, Laboratory, dagster_home
from tests.manifests import rewrite

BOTH = KEYS[2:]  # runs of the attacked mode
REPORT = dg.AssetKey("oracle_report")
RANGE = ("dagster/asset_partition_range_start", "dagster/asset_partition_range_end")


def test_nothing_starts_by_itself(empty: Laboratory) -> None:
    schedules = {schedule.name: schedule for schedule in defs.schedules or []}
    sensors = {sensor.name: sensor for sensor in defs.sensors or []}
    assert (set(schedules), set(sensors)) == ({"nightly", "weekly"}, {"changed_scenarios"})
    for schedule in schedules.values():
        assert schedule.default_status == dg.DefaultScheduleStatus.STOPPED
    for sensor in sensors.values():
        assert sensor.default_status == dg.DefaultSensorStatus.STOPPED
    assert not empty.instance.run_retries_enabled
    assert not empty.instance.freshness_enabled


def test_the_job_takes_every_asset_and_check() -> None:
    job, graph = defs.resolve_job_def("everything"), defs.resolve_asset_graph()
    assert job.asset_layer.executable_asset_keys == graph.materializable_asset_keys
    assert job.asset_layer.asset_graph.asset_check_keys == graph.asset_check_keys


def test_as_many_nights_as_there_are_runs_make_every_run_of_every_mode_again_once(
    empty: Laboratory,
) -> None:
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


# What a run is worth that was made again.


def ask(laboratory: Laboratory, request: dg.RunRequest) -> dg.ExecuteInProcessResult:
    """Do what the daemon does with a request, without the assets over all runs."""
    return (
        laboratory.defs()
        .resolve_job_def("everything")
        .execute_in_process(
            instance=laboratory.instance,
            tags=dict(request.tags),
            run_config=dict(request.run_config),
            asset_selection=[dg.AssetKey(asset) for asset in PER_RUN],
        )
    )


def results(outcome: dg.ExecuteInProcessResult) -> dict[str | None, dg.AssetCheckEvaluation]:
    """The results of the check in one Dagster run, by partition."""
    return {
        evaluation.partition: evaluation
        for evaluation in outcome.get_asset_check_evaluations()
        if evaluation.check_name == REPRODUCIBLE.name
    }


def recorded(laboratory: Laboratory) -> dict[str, tuple[int, int]]:
    """The files of the runs that are in use."""
    return {path: as_of for path, as_of in laboratory.files().items() if path.startswith("runs/")}


def test_a_run_that_comes_out_as_it_was_passes_and_one_that_is_verified_gives_no_result(
    copy_of_campaign: Laboratory,
) -> None:
    run = copy_of_campaign.store.run(BOTH[0])
    before, hash_before = copy_of_campaign.files(), run.manifest().content_hash
    found = results(ask(copy_of_campaign, made_again(run.key, run.key)))
    assert found.keys() == {run.key}
    result = found[run.key]
    assert result.passed
    assert result.metadata["former_hash"].value == result.metadata["new_hash"].value == hash_before
    assert result.target_materialization_data is not None
    assert {copy_of_campaign.figures(asset, run.key)["status"] for asset in PER_RUN} == {"made"}
    after = copy_of_campaign.files()
    changed = {path for path in after if after[path] != before.get(path)}
    assert changed == {path for path in after if f"/{run.mode}/{run.run_id}" in path}
    assert run.manifest().content_hash == hash_before
    assert not place_aside(run).path.exists()
    verified = copy_of_campaign.materialize(PER_RUN, run.key)
    assert verified.success
    assert results(verified) == {}


def test_other_software_or_another_recipe_explains_another_run_and_it_is_replaced(
    copy_of_campaign: Laboratory,
) -> None:
    of_software, of_recipe = (copy_of_campaign.store.run(key) for key in BOTH)
    hashes = {run.key: run.manifest().content_hash for run in (of_software, of_recipe)}

    def other_software(document: dict[str, Any]) -> None:
        document["software"]["code"] = "of last year"
        document["content_hash"] = "0" * 64

    def other_recipe(document: dict[str, Any]) -> None:  # as when a scenario file has changed
        document["recipe"]["scenario"]["title"] = "What it was called last year"
        document["content_hash"] = "1" * 64

    rewrite(of_software, other_software)
    rewrite(of_recipe, other_recipe)
    found = results(ask(copy_of_campaign, made_again(*BOTH)))
    for run, what in ((of_software, "code"), (of_recipe, "recipe")):
        assert found[run.key].passed
        assert what in str(found[run.key].description)
        assert found[run.key].metadata["new_hash"].value == hashes[run.key]
        assert run.manifest().content_hash == hashes[run.key]
        assert not place_aside(run).path.exists()


def test_a_difference_that_nothing_explains_fails_and_both_runs_are_kept(
    copy_of_campaign: Laboratory,
) -> None:
    run, other = (copy_of_campaign.store.run(key) for key in BOTH)
    right, wrong = run.manifest().content_hash, other.manifest().content_hash
    own = json.loads(run.manifest_path.read_text(encoding="utf-8"))
    shutil.rmtree(run.path)
    shutil.copytree(other.path, run.path)
    who = ("run", "block", "session", "recipe")
    rewrite(run, lambda document: document.update({name: own[name] for name in who}))
    before = recorded(copy_of_campaign)

    outcome = ask(copy_of_campaign, made_again(BOTH[0], BOTH[0]))
    assert outcome.success  # the check tells; what could be made is there
    result = results(outcome)[run.key]
    assert not result.passed
    aside = place_aside(run)
    told = {name: value.value for name, value in result.metadata.items()}
    assert str(told.pop("first_difference")).startswith("/")
    assert told == {
        "former_hash": wrong,
        "new_hash": right,
        "former_path": str(run.path),
        "new_path": str(aside.path),
    }
    assert aside.manifest().content_hash == right
    assert recorded(copy_of_campaign) == before
    assert len(copy_of_campaign.store.complete_runs()) == len(KEYS)

    rewrite(run, lambda document: document.update(content_hash=right))  # as if it were explained
    assert results(ask(copy_of_campaign, made_again(BOTH[0], BOTH[0])))[run.key].passed
    assert not aside.path.exists()


def test_the_first_message_that_differs_is_named(campaign: Laboratory) -> None:
    one, other = (campaign.store.run(key) for key in BOTH)
    # Two recipes that are said to be one: the first messages that differ are known by hand.
    former = dataclasses.replace(one.manifest(), recipe=other.manifest().recipe)
    with BagReader(one.bag) as bag, BagReader(other.bag) as second:
        pairs = zip(bag.messages(), second.messages(), strict=False)
        a, b = next(pair for pair in pairs if pair[0] != pair[1])
        earlier = min(a, b, key=lambda message: message.stamp_ns)
        seconds = (earlier.stamp_ns - bag.start_ns) / 1e9
    found = judge(one, former, other)
    assert found.verdict == "unexplained"
    assert found.first_difference == f"{earlier.topic}, {seconds:.3f} s after the first message"


def test_an_edited_manifest_and_a_dropped_bag_are_told_apart_from_other_messages(
    campaign: Laboratory,
) -> None:
    run = campaign.store.run(KEYS[0])
    manifest = run.manifest()
    edited = dataclasses.replace(manifest, content_hash="0" * 64)
    assert judge(run, edited, run).first_difference.startswith("none: the bags hold the same")
    measured = dataclasses.replace(manifest.measured, kept="recipe")
    dropped = dataclasses.replace(edited, measured=measured)
    assert judge(run, dropped, run).first_difference.startswith("not known: the former bag")


# The sensor.

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


def test_a_changed_scenario_asks_once_for_its_materialized_runs_and_no_others(
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


def test_a_change_back_and_forth_is_asked_for_again(watched: Laboratory, scenario: Path) -> None:
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


def test_a_new_layout_of_a_file_is_no_change(watched: Laboratory, scenario: Path) -> None:
    cursor = tick(watched, None).cursor
    scenario.write_text("# A comment.\n" + scenario.read_text(encoding="utf-8"), encoding="utf-8")
    assert not tick(watched, cursor).run_requests


def test_a_broken_file_is_named_and_asked_for_once_it_is_mended(
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


def test_a_changed_scenario_without_materialized_runs_asks_for_nothing(
    empty: Laboratory, scenario: Path
) -> None:
    cursor = tick(empty, None).cursor
    edit(scenario, title="Another title")
    seen = tick(empty, cursor)
    assert not seen.run_requests
    assert f"{MODE} has changed, and no run of it is materialized." in seen.skip_message


# What Dagster remembers.


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
    (told,) = [e for e in done.all_events if e.event_type_value == "STEP_OUTPUT"]
    return {name: value.value for name, value in told.step_output_data.metadata.items()}


def test_old_runs_are_forgotten_but_for_those_that_something_points_at(empty: Laboratory) -> None:
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
    told = forget(empty, days=0)
    assert told == {"forgotten": len(old) + 1, "old_and_in_use": len(in_use)}  # and the job's first
    assert not any(instance.has_run(run) for run in old)
    assert all(instance.has_run(run) for run in [*in_use, going_on])
    assert seen() == before
    assert before[0] == {"a", "b"}
    home = Path(instance.root_directory)
    assert not [path for run in old for path in home.rglob(f"*{run}*")]


# Run retries and freshness, as dagster.yaml has them but for the switch.


@pytest.fixture
def switched_on(tmp_path: Path) -> Iterator[dg.DagsterInstance]:
    settings = yaml.safe_load((ROOT / ".dagster_home" / "dagster.yaml").read_text(encoding="utf-8"))
    for part in ("run_retries", "freshness"):
        settings[part]["enabled"] = True
    home = tmp_path / "on"
    home.mkdir()
    (home / "dagster.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    with dg.DagsterInstance.from_config(str(home)) as instance:
        yield instance


@dg.op
def fails() -> None:
    raise dg.Failure("The experiment went wrong.")


@dg.job
def failing() -> None:
    fails()


def test_a_run_whose_process_died_is_retried_once_and_one_that_failed_is_not(
    switched_on: dg.DagsterInstance,
) -> None:
    died = switched_on.create_run_for_job(failing, status=dg.DagsterRunStatus.STARTED)
    switched_on.report_run_failed(died)
    failed = failing.execute_in_process(instance=switched_on, raise_on_error=False).run_id

    def will_be_retried(run_id: str) -> str:
        run = switched_on.get_run_by_id(run_id)
        assert run is not None
        return run.tags[WILL_RETRY_TAG]

    assert will_be_retried(died.run_id) == "true"
    assert will_be_retried(failed) == "false"
    again = switched_on.create_run_for_job(
        failing,
        status=dg.DagsterRunStatus.STARTED,
        root_run_id=died.run_id,
        parent_run_id=died.run_id,
        tags={ROOT_RUN_ID_TAG: died.run_id, PARENT_RUN_ID_TAG: died.run_id},
    )
    switched_on.report_run_failed(again)
    assert will_be_retried(again.run_id) == "false"


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
