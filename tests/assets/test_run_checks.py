"""Each check passes on an undamaged run, and fails on one with only the damage to detect."""

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
from oracle_pipeline.bags.integrity import hashes_of_files
from oracle_pipeline.bags.reader import BagReader, RawMessage, read_ground_truth
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.datasets import read_table, write_table
from tests.assets.laboratory import ATTACKED, KEY, KEYS, PARTNER, Laboratory
from tests.manifests import rewrite

pytestmark = pytest.mark.slow

ASSET_OF = {check.name: check.asset_key for check in CHECKS}
OF_RUNS = sorted(set(ASSET_OF.values()))


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
def test_undamaged_runs_pass_with_separate_results(campaign: Laboratory, check: str) -> None:
    found = evaluations(campaign, check)
    # The controls were recorded first, and had no counterpart yet.
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
    files = hashes_of_files(run.path)  # as if it had been recorded
    rewrite(run, lambda document: document["measured"].update(files=files))


def bit_flipped(folder: Path) -> None:
    """Flip a bit in the largest file of a folder, where its content is."""
    file = max(folder.iterdir(), key=lambda path: path.stat().st_size)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def messages_exchanged(run: RunDirectory) -> None:
    """Put a bag with the same counts in place of the run's own, and its files' hashes with it."""
    with BagReader(run.bag) as bag:
        topics, (first, second, *rest) = bag.topics, list(bag.messages(["/odom"]))
        others = [message for message in bag.messages() if message.topic != "/odom"]
    swapped = [first._replace(data=second.data), second._replace(data=first.data), *rest]
    truth = [
        RawMessage(GROUND_TRUTH_TOPIC, stamp_ns, serialize(message, GROUND_TRUTH_TYPE))
        for stamp_ns, message in read_ground_truth(run.bag)
    ]
    shutil.rmtree(run.bag)
    with BagWriter(run.bag) as writer:
        for topic in topics.values():
            writer.add_topic(topic.name, topic.msgtype, topic.qos)
        writer.add_topic(GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, [])
        for message in sorted([*swapped, *others, *truth], key=lambda message: message.stamp_ns):
            writer.write(*message)
    files = hashes_of_files(run.path)
    rewrite(run, lambda document: document["measured"].update(files=files))


def value_lost(place: Path) -> None:
    df = read_table(place)
    df.loc[len(df) - 1, "structural.density"] = np.nan
    write_table(df, place)


Damage = Callable[[RunDirectory], None]


@pytest.mark.parametrize(
    ("name", "damage", "said"),
    [
        ("bag_is_complete", other_bag, "recorded"),
        ("bag_is_complete", cut_bag, "bag"),
        ("bag_is_complete", lambda run: bit_flipped(run.bag), "corrupt"),
        ("bag_is_complete", messages_exchanged, "hash"),
        (
            "every_interval_has_a_graph",
            lambda run: bit_flipped(run.graphs),
            "changed since it was recorded",
        ),
        (PAIR_CHECK, lambda run: bit_flipped(run.graphs), "damaged"),
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
def test_damage_is_detected(
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
    job = dg.define_asset_job(
        "only_checks", selection=dg.AssetSelection.checks_for_assets(*OF_RUNS)
    )
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
