"""Each check passes on a sound run, and fails on a run with just the damage it is there for."""

import shutil
from collections.abc import Callable
from pathlib import Path

import dagster as dg
import networkx as nx
import numpy as np
import pytest

from assets.run_checks import CHECKS, PAIR_CHECK
from assets.worker import inspections
from oracle_pipeline.bags.graph_files import read_gexf, write_gexf
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import read_table, write_table
from tests.assets.laboratory import ATTACKED, KEY, KEYS, PARTNER, Laboratory

ASSET_OF = {check.name: check.asset_key for check in CHECKS}


def evaluations(laboratory: Laboratory, check: str) -> dict[str | None, dg.AssetCheckEvaluation]:
    """The latest result for every partition that has one."""
    history = laboratory.instance.event_log_storage.get_asset_check_execution_history(
        dg.AssetCheckKey(ASSET_OF[check], check), limit=100
    )
    newest_last = sorted(history, key=lambda record: record.id)
    return {
        r.partition: r.evaluation
        for r in newest_last
        if isinstance(r.evaluation, dg.AssetCheckEvaluation)
    }


def newest(laboratory: Laboratory, asset: dg.AssetKey, key: str) -> dg.EventLogRecord:
    of_partition = dg.AssetRecordsFilter(asset_key=asset, asset_partitions=[key])
    return laboratory.instance.fetch_materializations(of_partition, limit=1).records[0]


@pytest.mark.parametrize("check", ASSET_OF)
def test_sound_runs_pass_each_with_a_result_of_its_own(campaign: Laboratory, check: str) -> None:
    found = evaluations(campaign, check)
    # The controls were there first, and had nothing to be compared with.
    expected = KEYS[2:] if check == PAIR_CHECK else KEYS
    assert sorted(map(str, found)) == expected
    for key, evaluation in found.items():
        assert evaluation.passed, evaluation.description
        assert evaluation.target_materialization_data is not None
        checked = evaluation.target_materialization_data.storage_id
        assert checked == newest(campaign, ASSET_OF[check], str(key)).storage_id
        assert evaluation.metadata["wrong"].value == 0
        assert len(evaluation.metadata) > 1


def other_bag(run: RunDirectory) -> None:
    """Put a bag with other counts in place of the run's own."""
    shutil.rmtree(run.bag)
    shutil.copytree(RunDirectory(run.root, ATTACKED, 1).bag, run.bag)


def cut_bag(run: RunDirectory) -> None:
    bag = next(run.bag.glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])


def last_graph_lost(run: RunDirectory) -> None:
    max(path for path in run.graphs.glob("*.gexf") if path.stem.isdecimal()).unlink()


def node_added(run: RunDirectory) -> None:
    graph = nx.DiGraph(read_gexf(run.graphs / "000000.gexf"))
    graph.add_node("node:/intruder", kind="node", type="", label="/intruder")
    write_gexf(graph, run.graphs / "000000.gexf")


def value_lost(place: Path) -> None:
    df = read_table(place)
    df.loc[0, "structural.density"] = np.nan
    write_table(df, place)


Damage = Callable[[RunDirectory], None]


@pytest.mark.parametrize(
    ("name", "damage", "said"),
    [
        ("bag_is_complete", other_bag, "recorded"),
        ("bag_is_complete", cut_bag, "bag"),
        ("every_interval_has_a_graph", last_graph_lost, "no graph"),
        (PAIR_CHECK, node_added, "node:/intruder"),
        (
            "run_features_are_finite",
            lambda run: value_lost(run.feature_table("run")),
            "structural.density",
        ),
        (
            "window_features_are_finite",
            lambda run: value_lost(run.feature_table("window")),
            "structural.density",
        ),
    ],
)
def test_damage_is_found(
    copy_of_campaign: Laboratory, name: str, damage: Damage, said: str
) -> None:
    control, attacked = (copy_of_campaign.store.run(key) for key in (PARTNER, KEY))
    subject = (control, attacked) if name == PAIR_CHECK else (attacked,)
    inspection = inspections.Inspection(name, subject)
    assert inspections.inspect(inspection).wrong == []
    damage(attacked)
    assert any(said in wrong for wrong in inspections.inspect(inspection).wrong)


def test_damage_to_one_run_fails_its_own_check_and_no_other(copy_of_campaign: Laboratory) -> None:
    cut_bag(copy_of_campaign.store.run(KEY))
    job = dg.define_asset_job("only_checks", selection=dg.AssetSelection.all_asset_checks())
    defs = dg.Definitions.merge(copy_of_campaign.defs(), dg.Definitions(jobs=[job]))
    tags = {
        "dagster/asset_partition_range_start": KEYS[2],
        "dagster/asset_partition_range_end": KEYS[3],
    }
    result = defs.resolve_job_def("only_checks").execute_in_process(
        instance=copy_of_campaign.instance, tags=tags
    )
    assert result.success
    failed = {
        (check, key)
        for check in ASSET_OF
        for key, evaluation in evaluations(copy_of_campaign, check).items()
        if not evaluation.passed
    }
    assert failed == {("bag_is_complete", KEY)}
    found = evaluations(copy_of_campaign, "bag_is_complete")[KEY]
    assert str(copy_of_campaign.store.run(KEY).bag) in str(found.description)
