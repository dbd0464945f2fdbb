"""A Dask cluster, a store on S3, an instance on PostgreSQL: the same runs and tables as here."""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any
from unittest import mock

import dagster as dg
import pytest

from assets.experiment_runs import REPRODUCIBLE
from assets.worker.reproduction import refreshed_directory
from oracle_pipeline.bags.run_directory import bytes_on_disk, find_runs
from oracle_pipeline.datasets import content_hash, feature_dataset, read_table
from oracle_pipeline.reporting.stored_report import Report
from resources.fleet import Fleet
from resources.store import RunStore
from tests.assets.laboratory import KEY, PARTNER, PER_RUN, Laboratory
from tests.assets.test_run_checks import ASSET_OF, evaluations
from tests.manifests import rewrite
from tests.servers import ROOT, dask_cluster, postgres_server, s3_server

pytestmark = pytest.mark.slow(5)

STORE = RunStore(root="s3://oracle/campaign")
OVER_ALL = ["feature_dataset", "bootstrapped_dataset"]


class SharedLaboratory(Laboratory):
    """A root in a bucket, without files on this machine."""

    address: str

    @property
    def store(self) -> RunStore:
        return STORE

    def materialize(self, *args: Any, **kwargs: Any) -> dg.ExecuteInProcessResult:
        return super().materialize(*args, fleet=Fleet(address=self.address), **kwargs)

    def objects(self) -> dict[str, tuple[str, str]]:
        """Every object below the root with its time stamp and hash."""
        found = STORE.path.fs.find(STORE.path.path, detail=True)  # type: ignore[attr-defined]
        return {name: (str(of["LastModified"]), of["ETag"]) for name, of in sorted(found.items())}


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedLaboratory]:
    """A pair of runs, made by a cluster, in a bucket, and the tables over them."""
    folder = tmp_path_factory.mktemp("engines")
    with ExitStack() as servers:
        for variables in (
            servers.enter_context(s3_server("oracle")),
            servers.enter_context(postgres_server()),
        ):
            servers.enter_context(mock.patch.dict(os.environ, variables))
        address = servers.enter_context(dask_cluster(folder / "dask", workers=1))
        shutil.copy(ROOT / "deploy" / "dagster.yaml", folder)
        instance = servers.enter_context(dg.DagsterInstance.from_config(str(folder)))
        laboratory = SharedLaboratory(folder / "data", instance)
        laboratory.address = address
        assert laboratory.materialize(PER_RUN, PARTNER).success
        assert laboratory.materialize([*PER_RUN, *OVER_ALL], KEY).success
        yield laboratory


def test_a_cluster_gives_the_same_runs_as_this_machine(
    shared: SharedLaboratory, campaign: Laboratory
) -> None:
    assert [run.key for run in find_runs(STORE.path)] == [PARTNER, KEY]
    for key in (PARTNER, KEY):
        theirs, ours = STORE.run(key), campaign.store.run(key)
        assert theirs.manifest().content_hash == ours.manifest().content_hash
        assert theirs.manifest().task_effect == ours.manifest().task_effect
        assert bytes_on_disk(theirs.path) == theirs.manifest().measured.bytes
        for asset in PER_RUN:
            tags = [one.latest(asset, key).tags or {} for one in (shared, campaign)]
            assert tags[0]["dagster/data_version"] == tags[1]["dagster/data_version"]
    for asset in PER_RUN:
        assert shared.materialized(asset) == {PARTNER, KEY}


def test_tables_and_reports_in_a_bucket_are_those_of_a_folder(
    shared: SharedLaboratory, campaign: Laboratory
) -> None:
    runs = [campaign.store.run(key) for key in (PARTNER, KEY)]
    joined = feature_dataset([read_table(run.feature_table("run")) for run in runs])
    assert content_hash(read_table(STORE.dataset("features"))) == content_hash(joined)
    place = shared.figures("feature_dataset")["path"]
    assert place == f"{STORE.root}/datasets/features.parquet"
    drawn = Report.load(STORE.results("bootstrapped_dataset"))
    assert set(drawn.table["run_id"]) == {PARTNER, KEY}


def test_nothing_is_left_on_this_machine(shared: SharedLaboratory) -> None:
    assert not shared.root.exists()


def test_checks_read_what_is_in_the_bucket(shared: SharedLaboratory) -> None:
    for check in ASSET_OF:
        found = evaluations(shared, check)
        assert KEY in found
        assert [e.description for e in found.values() if not e.passed] == []


def test_progress_reaches_the_log_of_the_run(shared: SharedLaboratory) -> None:
    run = shared.instance.get_runs()[-1]
    messages = [record.user_message for record in shared.instance.all_logs(run.run_id)]
    done = re.compile(r"1 of 1 runs done in \d+ (s|min), none failed\.")
    assert any(done.match(said) for said in messages)


def test_complete_runs_are_only_verified(shared: SharedLaboratory) -> None:
    before = shared.objects()
    assert shared.materialize(PER_RUN, KEY).success
    assert shared.objects() == before
    assert {shared.figures(asset, KEY)["status"] for asset in PER_RUN} == {"verified"}


def test_features_alone_are_extracted_from_the_bag_in_the_bucket(shared: SharedLaboratory) -> None:
    place = STORE.run(KEY).feature_table("run")
    version = content_hash(read_table(place))
    place.unlink()
    assert shared.materialize(["run_features"], KEY).success
    assert content_hash(read_table(place)) == version


def test_a_damaged_run_is_reported_and_without_its_manifest_re_simulated(
    shared: SharedLaboratory,
) -> None:
    run = STORE.run(KEY)
    version = run.manifest().content_hash
    (run.graphs / "000000.gexf").unlink()
    (run.graphs / "left_over.gexf").write_bytes(b"of a former version")
    result = shared.materialize(PER_RUN, KEY)
    assert not result.success
    failure = str(result.failure_data_for_node("runs"))
    assert "1 of 1 runs failed" in failure
    assert f"{KEY}: {run.path} is damaged" in failure
    messages = [record.user_message for record in shared.instance.all_logs(result.run_id)]
    assert any(text.startswith(f"{KEY} failed: ") for text in messages)

    run.manifest_path.unlink()  # it comes last: as if the run was partly published
    assert not run.is_complete()
    assert shared.materialize(PER_RUN, KEY).success
    assert run.manifest().content_hash == version
    assert bytes_on_disk(run.path) == run.manifest().measured.bytes


def test_a_run_with_unexplained_differences_is_stored_beside_the_one_in_the_bucket(
    shared: SharedLaboratory,
) -> None:
    run = STORE.run(KEY)
    version = run.manifest().content_hash
    # As if this very software had recorded other messages.
    rewrite(run, lambda document: document.update(content_hash="0" * 64))
    before = {name: of for name, of in shared.objects().items() if "/runs/" in name}

    outcome = shared.materialize(PER_RUN, KEY, config={"runs": {"refresh": True}})
    found = {each.check_name: each for each in outcome.get_asset_check_evaluations()}
    assert not found[REPRODUCIBLE.name].passed
    aside = refreshed_directory(run)
    assert aside.manifest().content_hash == version
    assert bytes_on_disk(aside.path) == aside.manifest().measured.bytes
    now = shared.objects()
    assert before == {name: now[name] for name in before}
