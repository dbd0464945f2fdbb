"""Recordings in an object store: read as those of a folder."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from oracle_pipeline.bags.remote import fetched, place_at, publish
from oracle_pipeline.cli import main as oracle
from tests.recorded_runs import RecordedRuns
from tests.servers import s3_server

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    with s3_server("oracle") as variables, pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        yield "s3://oracle"


def test_a_folder_and_a_file_have_the_features_of_their_copies_here(
    bucket: str, recorded_run: RecordedRuns, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(recorded_run("fake_object").bag, bag)
    (file,) = bag.glob("*.mcap")
    publish(bag, place_at(f"{bucket}/night/bag"), last="metadata.yaml")
    places = [bag, f"{bucket}/night/bag", f"{bucket}/night/bag/{file.name}"]
    done = CliRunner().invoke(oracle, ["features", *map(str, places), "--format", "json"])
    assert done.exit_code == 0, done.output
    ours, folder, alone = json.loads(done.stdout)["rows"]
    assert folder["run_id"].endswith("/oracle/night/bag")
    of_place = {"run_id", "block"}
    assert all(folder[name] == value for name, value in ours.items() if name not in of_place)
    assert ours.keys() == alone.keys()


def test_an_object_whose_name_leaves_its_folder_is_not_copied(bucket: str) -> None:
    folder = place_at(f"{bucket}/night/odd")
    for name in ("fine.txt", "../../../../leaving.txt"):
        folder.fs.pipe_file(f"{folder.path}/{name}", b"text")  # type: ignore[attr-defined]
    assert len(folder.fs.find(folder.path)) == 2  # type: ignore[attr-defined]
    with fetched(folder) as local:
        copied = [file.name for file in local.parents[2].rglob("*") if file.is_file()]
        assert copied == ["fine.txt"]
        assert not (local.parents[3] / "leaving.txt").exists()


@pytest.mark.parametrize(
    ("place", "reason"),
    [("s3://oracle/none", "does not exist"), ("nowhere://oracle/bag", "cannot be read")],
)
def test_what_is_not_there_ends_with_a_reason(bucket: str, place: str, reason: str) -> None:
    done = CliRunner().invoke(oracle, ["check", place])
    assert done.exit_code == 2
    assert f"{place} {reason}" in done.stderr
