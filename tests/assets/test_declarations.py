"""The descriptions of every asset, check, job and setting in the UI."""

import re
from graphlib import TopologicalSorter
from typing import Any

import dagster as dg
import pytest

from oracle_pipeline.definitions import defs
from tests.assets.laboratory import EVERYTHING, KEY, PER_RUN, Laboratory

GRAPH = defs.resolve_asset_graph()
ASSETS = sorted(GRAPH.get_all_asset_keys())
NODES = [GRAPH.get(key) for key in ASSETS]
# Tables: their rows are counted and their columns described under Dagster's own keys.
TABLES = [
    asset
    for asset in EVERYTHING
    if asset not in ("experiment_runs", "bags", "interval_graphs", "oracle_report")
]


@pytest.mark.parametrize("asset", NODES, ids=lambda node: node.key.to_user_string())
def test_every_asset_has_description_owner_path_and_kinds(asset: Any) -> None:
    summary, _, rest = (asset.description or "").partition("\n\n")
    assert summary.endswith(".")
    assert len(rest) > 40
    assert asset.owners == ["team:behaviour-oracle"]
    assert asset.group_name not in (None, "default")
    assert asset.kinds
    assert asset.tags["scope"] in ("run", "campaign", "batch")
    assert (asset.tags["scope"] == "campaign") == (asset.partitions_def is None)
    assert asset.metadata["place"].value.startswith("<ORACLE_HOME>/")
    assert asset.code_version


def test_groups_read_from_left_to_right() -> None:
    before: dict[str, set[str]] = {}
    for node in NODES:
        parents = {GRAPH.get(parent).group_name for parent in node.parent_keys}
        before.setdefault(node.group_name, set()).update(parents - {node.group_name})
    order = list(TopologicalSorter(before).static_order())  # raises if there is a circle
    assert order.index("simulation") < order.index("features") < order.index("oracle")


def test_every_check_has_a_description() -> None:
    for key in GRAPH.asset_check_keys:
        assert len(GRAPH.get_check_spec(key).description or "") > 30, key


def test_every_job_schedule_and_sensor_has_a_description() -> None:
    jobs = [job for job in defs.resolve_all_job_defs() if not job.name.startswith("__")]
    assert {"everything", "simulate", "features", "report", "evaluate", "thesis"} <= {
        job.name for job in jobs
    }
    for each in [*jobs, *(defs.schedules or []), *(defs.sensors or [])]:
        assert re.search(r"\w+.{20,}\.$", each.description or "", re.DOTALL), each.name


def settings() -> list[tuple[str, Any]]:
    """Every field of the config of ops and resources, by its path."""
    found = {}
    for job in defs.resolve_all_job_defs():
        for node in job.all_node_defs:
            fields = getattr(getattr(node, "config_field", None), "config_type", None)
            found |= {f"{node.name}.{n}": f for n, f in getattr(fields, "fields", {}).items()}
        for name, resource in job.resource_defs.items():
            fields = resource.config_schema.config_type
            found |= {f"{name}.{n}": f for n, f in getattr(fields, "fields", {}).items()}
    return sorted(found.items())


def test_there_are_documented_settings() -> None:
    names = {name for name, _ in settings()}
    assert {"runs.refresh", "campaign.goals_per_run", "judge_recordings.far"} <= names


@pytest.mark.parametrize(("name", "field"), settings(), ids=lambda value: str(value)[:40])
def test_every_setting_is_explained(name: str, field: Any) -> None:
    assert len(field.description or "") > 15, name


@pytest.mark.slow
@pytest.mark.parametrize("asset", EVERYTHING)
def test_every_materialization_has_a_place_and_a_number_that_plots(
    campaign: Laboratory, asset: str
) -> None:
    shown = campaign.latest(asset, KEY if asset in PER_RUN else None).metadata
    assert isinstance(shown["path"], dg.PathMetadataValue)
    numbers = (dg.IntMetadataValue, dg.FloatMetadataValue)
    assert any(isinstance(value, numbers) for value in shown.values())


@pytest.mark.slow
@pytest.mark.parametrize("asset", TABLES)
def test_the_newest_materialization_of_a_table_describes_its_columns(
    campaign: Laboratory, asset: str
) -> None:
    shown = campaign.latest(asset).metadata
    assert shown["dagster/row_count"].value > 0
    schema = shown["dagster/column_schema"]
    assert isinstance(schema, dg.TableSchemaMetadataValue)
    columns = schema.schema.columns
    assert all(column.type for column in columns)
    if asset.endswith("_features"):
        features = [column for column in columns if "." in column.name]
        assert len(features) > 50
        assert all(re.search(r"\w+.* \[.+\]$", column.description or "") for column in features)
