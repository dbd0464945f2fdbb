"""A run config cannot choose a host to connect to or a path to write to."""

from collections.abc import Iterator

import dagster as dg
import pytest

from oracle_pipeline.definitions import build_defs, defs
from resources.fleet import Fleet
from resources.no_values import NoValues
from resources.store import RunStore

JOBS = {
    "every asset": defs.resolve_implicit_global_asset_job_def(),
    "everything": defs.resolve_job_def("everything"),
    "report": defs.resolve_job_def("report"),
}
# Free text that a run's config may hold, and none of it names a host or a place.
HARMLESS_TEXT = {
    "resources.budget.config.limit",  # a number of bytes
    "ops.oracle_evaluation.config.testbed",  # compared with what manifests say
    "ops.bootstrapped_dataset.config.testbed",
    "loggers.console.config.log_level",
    "loggers.console.config.name",
}


def text_fields(kind: object, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the paths of all fields of a config schema that take text of any form."""
    for name, field in getattr(kind, "fields", {}).items():
        yield from text_fields(field.config_type, (*path, name))
    if "String" in str(getattr(kind, "key", "")):
        yield ".".join(path)


@pytest.mark.parametrize("job", JOBS.values(), ids=JOBS)
def test_the_run_config_cannot_set_a_host_or_a_path(job: dg.JobDefinition) -> None:
    found = set(text_fields(job.run_config_schema.config_type))
    assert found  # the walk sees the schema
    assert found <= HARMLESS_TEXT


@pytest.mark.parametrize(
    ("resource", "setting", "value"),
    [
        ("fleet", "address", "tcp://192.0.2.1:8786"),
        ("store", "root", "/tmp/elsewhere"),  # noqa: S108
        ("io_manager", "base_dir", "/tmp/elsewhere"),  # noqa: S108
    ],
)
@pytest.mark.parametrize("job", JOBS.values(), ids=JOBS)
def test_a_run_config_with_a_host_or_path_is_an_error(
    job: dg.JobDefinition, resource: str, setting: str, value: str
) -> None:
    config = {"resources": {resource: {"config": {setting: value}}}}
    with pytest.raises(dg.DagsterInvalidConfigError, match=f'"({setting}|config|{resource})"'):
        dg.validate_run_config(job, config)


def test_the_environment_sets_root_and_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORACLE_HOME", "s3://bucket/prefix")
    monkeypatch.setenv("ORACLE_DASK", "tcp://192.0.2.1:8786")
    resources = build_defs().resources or {}
    store, fleet = resources["store"], resources["fleet"]
    assert isinstance(store, RunStore)
    assert isinstance(fleet, Fleet)
    assert store.root == "s3://bucket/prefix"
    assert fleet.address == "tcp://192.0.2.1:8786"


def test_a_step_sees_the_place_that_was_set() -> None:
    seen = []

    @dg.asset
    def looks(store: RunStore, fleet: Fleet) -> None:
        seen.append((store.root, fleet.address))

    resources = {"store": RunStore(root="somewhere"), "fleet": Fleet(address="tcp://a:1")}
    assert dg.materialize([looks], resources=resources).success
    assert seen == [("somewhere", "tcp://a:1")]


def test_no_value_between_assets_is_pickled() -> None:
    @dg.asset
    def gives() -> int:
        return 1

    with pytest.raises(dg.DagsterInvariantViolationError, match="run store"):
        dg.materialize([gives], resources={"io_manager": NoValues()})
