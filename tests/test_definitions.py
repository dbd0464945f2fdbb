"""The definitions as a whole: they load, and they are the graph that users know."""

import subprocess
import sys

import dagster as dg
import pytest

from oracle_pipeline.definitions import build_defs, defs
from resources.fleet import Fleet

GRAPH = {
    "experiment_runs": ("simulation", set()),
    "bags": ("recording", {"experiment_runs"}),
    "interval_graphs": ("recording", {"bags"}),
    "window_features": ("features", {"bags", "interval_graphs"}),
    "run_features": ("features", {"bags", "interval_graphs"}),
    "feature_dataset": ("datasets", {"run_features", "window_features"}),
    "bootstrapped_dataset": ("datasets", {"feature_dataset"}),
    "clustering_grid_search": ("thesis_method", {"bootstrapped_dataset"}),
    "malicious_rate_report": ("thesis_method", {"bootstrapped_dataset", "feature_dataset"}),
    "pairwise_report": ("thesis_method", {"bootstrapped_dataset", "feature_dataset"}),
    "oracle_evaluation": ("oracle", {"feature_dataset"}),
    "oracle_report": (
        "oracle",
        {
            "feature_dataset",
            "clustering_grid_search",
            "malicious_rate_report",
            "pairwise_report",
            "oracle_evaluation",
        },
    ),
    "foreign_features": ("foreign", set()),
    "foreign_verdicts": ("foreign", {"foreign_features"}),
    "foreign_report": ("foreign", {"foreign_verdicts"}),
}


def test_definitions_load() -> None:
    dg.Definitions.validate_loadable(defs)


def test_the_graph_is_the_one_that_users_know() -> None:
    graph = defs.resolve_asset_graph()
    nodes = {key.to_user_string(): graph.get(key) for key in graph.get_all_asset_keys()}
    assert {
        name: (node.group_name, {parent.to_user_string() for parent in node.parent_keys})
        for name, node in nodes.items()
    } == GRAPH


def test_every_asset_has_a_description() -> None:
    for spec in defs.resolve_all_asset_specs():
        assert spec.description, spec.key
        assert len(spec.description.splitlines()[0]) <= 100
        assert spec.owners, spec.key
        assert spec.kinds, spec.key
        assert spec.code_version, spec.key


def test_any_range_of_partitions_is_one_dagster_run() -> None:
    graph = defs.resolve_asset_graph()
    for key in graph.materializable_asset_keys:
        assert graph.get(key).backfill_policy == dg.BackfillPolicy.single_run()
    of_commands = {graph.get(key).partitions_def for key in graph.materializable_asset_keys}
    assert len(of_commands - {None}) == 1  # Dagster refuses a command over two


def test_all_automation_is_off_by_default() -> None:
    assert {s.default_status for s in defs.sensors or []} == {dg.DefaultSensorStatus.STOPPED}
    schedules = [s for s in defs.schedules or [] if isinstance(s, dg.ScheduleDefinition)]
    assert {s.default_status for s in schedules} == {dg.DefaultScheduleStatus.STOPPED}


def test_resources_can_be_replaced_and_only_known_ones() -> None:
    fleet = Fleet(workers=1)
    assert build_defs(fleet=fleet).resources["fleet"] is fleet  # type: ignore[index]
    with pytest.raises(TypeError, match="flete"):
        build_defs(flete=fleet)


@pytest.mark.slow
def test_loading_the_code_location_does_not_import_the_analysis() -> None:
    code = (
        "import sys, oracle_pipeline.definitions\n"
        "print([m for m in ('mujoco', 'pandas', 'sklearn', 'matplotlib') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
    assert found.stderr == ""  # no warnings of Dagster's own either
