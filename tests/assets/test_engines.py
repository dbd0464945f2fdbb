"""A campaign on a Dask cluster, its store on S3: the same runs, tables and reports as here."""

import os
from collections.abc import Iterator
from unittest import mock

import pytest

from assets.feature_tables import feature_table
from oracle_pipeline.bags.run_directory import bytes_on_disk
from oracle_pipeline.datasets import content_hash, read_table
from resources.fleet import Fleet
from resources.store import RunStore
from tests.assets.laboratory import EVERYTHING, KEY, KEYS, PARTNER, PER_RUN, Laboratory, dagster_home
from tests.assets.test_checks import ASSET_OF, evaluations
from tests.servers import dask_cluster, s3_server

STORE = RunStore(root="s3://oracle/campaign")


class SharedLaboratory(Laboratory):
    """Nothing of it is on this machine but its Dagster instance."""

    address: str

    @property
    def store(self) -> RunStore:
        return STORE

    def materialize(self, *args, **kwargs):  # type: ignore[no-untyped-def]
        return super().materialize(*args, fleet=Fleet(address=self.address), **kwargs)

    def objects(self) -> dict[str, tuple[str, str]]:
        """Every object below the root with its time stamp and hash."""
        found = STORE.path.fs.find(STORE.path.path, detail=True)  # type: ignore[attr-defined]
        return {name: (str(of["LastModified"]), of["ETag"]) for name, of in sorted(found.items())}


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedLaboratory]:
    """The campaign that tests share, made by a cluster, in a bucket."""
    folder = tmp_path_factory.mktemp("engines")
    with (
        s3_server("oracle") as variables,
        mock.patch.dict(os.environ, variables),
        dask_cluster(folder / "dask", workers=2) as address,
        dagster_home(folder / "home") as instance,
    ):
        laboratory = SharedLaboratory(folder / "data", instance)
        laboratory.address = address
        assert laboratory.materialize(EVERYTHING, KEYS[0], KEYS[-1]).success
        yield laboratory


def test_a_cluster_makes_the_runs_that_this_machine_makes(
    shared: SharedLaboratory, campaign: Laboratory
) -> None:
    assert [run.key for run in STORE.complete_runs()] == sorted(KEYS)
    for key in KEYS:
        there, here = STORE.run(key), campaign.store.run(key)
        assert there.manifest().content_hash == here.manifest().content_hash
        assert there.manifest().task_effect == here.manifest().task_effect
        assert bytes_on_disk(there.path) == there.manifest().measured.bytes
        for table in ("run", "window"):
            assert content_hash(read_table(feature_table(there, table))) == content_hash(
                read_table(feature_table(here, table))
            )
    for asset in PER_RUN:
        assert shared.materialized(asset) == set(KEYS)


def test_reports_over_s3_are_those_of_a_folder(
    shared: SharedLaboratory, campaign: Laboratory
) -> None:
    versions = {
        asset: [one.latest(asset).tags["dagster/data_version"] for one in (shared, campaign)]
        for asset in EVERYTHING[len(PER_RUN) : -1]
    }
    assert [asset for asset, (there, here) in versions.items() if there != here] == []
    assert shared.figures("oracle_report")["path"] == f"{STORE.root}/report/index.html"
    assert STORE.report.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_nothing_is_left_on_this_machine(shared: SharedLaboratory) -> None:
    assert not shared.root.exists()


def test_checks_read_what_is_in_the_bucket(shared: SharedLaboratory) -> None:
    for check in ASSET_OF:
        found = evaluations(shared, check)
        assert sorted(map(str, found)) == KEYS
        assert [e.description for e in found.values() if not e.passed] == []


def test_progress_reaches_the_log_of_the_run(shared: SharedLaboratory) -> None:
    run = shared.instance.get_runs()[-1]
    messages = [record.user_message for record in shared.instance.all_logs(run.run_id)]
    assert f"{len(KEYS)} of {len(KEYS)} jobs are over, 0 of them failed." in messages


def test_what_is_complete_is_verified_and_left_alone(shared: SharedLaboratory) -> None:
    before = shared.objects()
    assert shared.materialize(PER_RUN, KEY).success
    assert shared.objects() == before
    assert {shared.figures(asset, KEY)["status"] for asset in PER_RUN} == {"verified"}


def test_features_alone_are_extracted_from_the_bag_in_the_bucket(shared: SharedLaboratory) -> None:
    place = feature_table(STORE.run(KEY), "run")
    version = content_hash(read_table(place))
    place.unlink()
    assert shared.materialize(["run_features"], KEY).success
    assert content_hash(read_table(place)) == version


def test_a_damaged_run_fails_alone_and_is_made_again_whole(shared: SharedLaboratory) -> None:
    run = STORE.run(KEY)
    version = run.manifest().content_hash
    (run.graphs / "000000.gexf").unlink()
    (run.graphs / "left_over.gexf").write_bytes(b"of a former version")
    result = shared.materialize(PER_RUN, PARTNER, KEY)
    assert not result.success
    failure = str(result.failure_data_for_node("runs"))
    assert "1 of 2 runs failed" in failure
    assert f"{KEY}: {run.path} is damaged" in failure
    messages = [record.user_message for record in shared.instance.all_logs(result.run_id)]
    assert any(text.startswith(f"{KEY} failed: ") for text in messages)

    config = {"runs": {"refresh": True}}
    assert shared.materialize(PER_RUN, KEY, config=config).success
    assert run.manifest().content_hash == version
    assert bytes_on_disk(run.path) == run.manifest().measured.bytes


def test_a_run_of_which_only_a_part_was_published_is_made_again(shared: SharedLaboratory) -> None:
    run = STORE.run(KEY)
    version = run.manifest().content_hash
    run.manifest_path.unlink()  # it comes last
    assert not run.is_complete()
    assert shared.materialize(["bags"], KEY).success
    assert run.manifest().content_hash == version
