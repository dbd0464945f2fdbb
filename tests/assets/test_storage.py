"""Storage of runs: the plan, trimmed and dropped bags, and re-simulated bags."""

import contextlib
import dataclasses
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from assets.worker.feature_tables import topics_of_features
from assets.worker.inspections import Inspection, inspect
from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob, RunReport
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Kept
from oracle_pipeline.bags.reader import BagReader, content_hash, read_ground_truth
from oracle_pipeline.bags.retention import retain
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import read_table
from resources.budget import StorageBudget
from resources.storage.commands import remake, storage
from resources.storage.stock import take_stock
from resources.store import RunStore
from sim.campaigns import Campaign
from tests.assets.laboratory import ATTACKED, CONTROL, KEY, PER_RUN, Laboratory
from tests.locks import order_of_two
from tests.manifests import rewrite
from tools.soak.full_disk import largest_file

pytestmark = pytest.mark.slow

FEATURES = frozenset({"run_features"})


@pytest.fixture
def run(copy_of_campaign: Laboratory) -> RunDirectory:
    return copy_of_campaign.store.run(KEY)


def process(run: RunDirectory, keep: Kept, wanted: frozenset[str] = frozenset()) -> RunReport:
    return process_run(RunJob(run, Campaign(goals_per_run=1), wanted, refresh=False, keep=keep))


def files(root: Path) -> dict[str, tuple[int, int]]:
    """Every file by its inode and not by its content."""
    return {
        str(path.relative_to(root)): (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in root.rglob("*")
        if path.is_file()
    }


def test_a_trimmed_bag_has_the_decoded_topics_and_all_small_ones(run: RunDirectory) -> None:
    with BagReader(run.bag) as bag:
        wanted = topics_of_features(bag)
        before = {message for message in bag.messages() if message.topic in wanted}
    truth, manifest = read_ground_truth(run.bag), run.manifest()
    process(run, "trimmed")
    with BagReader(run.bag) as bag:
        assert {"/scan", "/odom", "/tf", "/cmd_vel"} <= bag.topics.keys()
        assert not {"/local_costmap/voxel_grid", "/received_global_plan"} & bag.topics.keys()
        assert {message for message in bag.messages() if message.topic in wanted} == before
        for name, topic in bag.topics.items():
            assert topic.count == manifest.topics[name].messages
    assert [stamp for stamp, _ in read_ground_truth(run.bag)] == [stamp for stamp, _ in truth]
    assert run.manifest().measured.bytes["bag"] < 0.6 * manifest.measured.bytes["bag"]
    assert inspect(Inspection("bag_is_complete", (run,))).wrong == []


def test_only_the_bag_is_dropped(run: RunDirectory) -> None:
    before, manifest = files(run.root), run.manifest()
    process(run, "recipe")
    gone = {name for name in before if name.startswith(f"runs/{ATTACKED}/run000/bag/")}
    changed = {f"runs/{ATTACKED}/run000/manifest.json"}
    after = files(run.root)
    assert before.keys() - after.keys() == gone
    assert {name for name in after if after[name] != before.get(name)} == changed
    measured = run.manifest().measured
    assert (measured.kept, measured.freed_bytes) == ("recipe", manifest.measured.bytes["bag"])
    assert run.manifest() == dataclasses.replace(manifest, measured=measured)
    assert inspect(Inspection("bag_is_complete", (run,))).wrong == []


def test_a_run_that_keeps_less_than_planned_is_verified_unchanged(run: RunDirectory) -> None:
    process(run, "recipe")
    before = files(run.root)
    report = process(run, "full", OF_A_RUN)
    assert {made.figures["status"] for made in report.assets.values()} == {"verified"}
    assert report.assets["bags"].figures["kept"] == "recipe"
    assert files(run.root) == before


def test_features_and_picture_are_computed_before_the_bag_is_dropped(run: RunDirectory) -> None:
    for table in ("run", "window"):
        run.feature_table(table).unlink()
    (run.path / "picture.png").unlink()
    process(run, "recipe")
    assert all(run.feature_table(table).is_file() for table in ("run", "window"))
    assert (run.path / "picture.png").is_file()


def test_features_of_a_dropped_run_re_simulate_its_bag_first(run: RunDirectory) -> None:
    place = run.feature_table("run")
    features, hash_before = read_table(place), run.manifest().content_hash
    process(run, "recipe")
    place.unlink()
    report = process(run, "full", FEATURES)
    assert report.simulated_s == run.manifest().recording_s
    assert read_table(place).equals(features)
    assert run.manifest().content_hash == content_hash(run.bag) == hash_before
    assert run.manifest().measured.kept == "full"


def test_a_run_of_other_software_is_not_reproducible_and_keeps_its_bag(run: RunDirectory) -> None:
    rewrite(run, lambda document: document["software"].update(code="of last year"))
    assert process(run, "recipe").kept == "full"
    assert run.bag.is_dir()


def test_a_run_that_was_derived_from_another_keeps_its_bag(run: RunDirectory) -> None:
    of = run.manifest().content_hash
    rewrite(run, lambda document: document["recipe"].update(mutant_of=of))
    assert process(run, "recipe").kept == "full"
    assert run.bag.is_dir()


def test_other_software_makes_a_new_generation_with_features_of_its_own(run: RunDirectory) -> None:
    process(run, "recipe")
    rewrite(run, lambda document: document["software"].update(code="of last year"))
    rewrite(run, lambda document: document.update(content_hash="0" * 64))
    record = run.feature_table("run").with_suffix(".json")
    record.write_text(record.read_text().replace('"inputs": "', '"inputs": "of last year '))
    report = process(run, "full", FEATURES)
    assert report.assets["run_features"].figures["status"] == "made"
    assert run.manifest().content_hash == content_hash(run.bag)
    assert run.manifest().software.code != "of last year"


def test_different_messages_from_the_same_software_are_an_error(run: RunDirectory) -> None:
    process(run, "recipe")
    rewrite(run, lambda document: document.update(content_hash="0" * 64))
    before = files(run.root)
    result = CliRunner().invoke(remake, [str(run.path)])
    assert result.exit_code == 1
    assert "its messages differ" in result.output
    assert files(run.root) == before


def test_remake_restores_a_bag_and_does_not_touch_a_complete_one(run: RunDirectory) -> None:
    before = content_hash(run.bag)
    process(run, "recipe")
    assert "room for" in CliRunner().invoke(storage, ["--root", str(run.root)]).output
    assert "re-simulated a bag" in CliRunner().invoke(remake, [str(run.path)]).output
    assert content_hash(run.bag) == run.manifest().content_hash == before
    files_before = files(run.root)
    assert "has its complete bag" in CliRunner().invoke(remake, [str(run.path)]).output
    assert files(run.root) == files_before


def test_on_a_full_disk_a_run_stays_as_it_was(run: RunDirectory) -> None:
    before = files(run.root)
    with pytest.raises(OracleError), largest_file(100_000):
        retain(run, "trimmed", topics_of_features)
    assert files(run.root) == before


def test_a_second_materialization_of_runs_waits_for_the_first(tmp_path: Path) -> None:
    store, budget = RunStore(root=str(tmp_path)), StorageBudget()
    assert order_of_two(lambda: budget.alone(store)) == ["first", "second"]


@contextlib.contextmanager
def watched(root: Path) -> Iterator[list[int]]:
    """Yield a list to which the content below a root is appended repeatedly."""
    seen: list[int] = []
    over = threading.Event()

    def watch() -> None:
        while not over.wait(0.02):
            seen.append(take_stock(root).total)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield seen
    finally:
        over.set()
        watcher.join()


def test_under_a_tight_budget_blocks_keep_alike_and_it_is_never_exceeded(
    copy_of_campaign: Laboratory,
) -> None:
    laboratory = copy_of_campaign
    budget = round(1.4 * take_stock(laboratory.root).total)
    tight = StorageBudget(limit=str(budget), reserve_mb=0)
    with watched(laboratory.root) as seen:
        for mode in (CONTROL, ATTACKED):
            assert laboratory.materialize(PER_RUN, f"{mode}|run002", budget=tight).success
    assert 0 < max(seen) <= budget
    kept = {
        mode: [
            RunDirectory(laboratory.root, mode, run).manifest().measured.kept for run in range(3)
        ]
        for mode in (CONTROL, ATTACKED)
    }
    assert kept[CONTROL] == kept[ATTACKED]
    assert kept[CONTROL] != ["full", "full", "full"]
    for mode, levels in kept.items():
        assert laboratory.figures("bags", f"{mode}|run002")["kept"] == levels[2]
        assert RunDirectory(laboratory.root, mode, 2).feature_table("run").is_file()
