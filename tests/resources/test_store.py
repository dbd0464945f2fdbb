"""The run store: its layout, and errors if it is not writable."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import dagster as dg
import pandas as pd
import pytest

from oracle_pipeline.bags.remote import fetched, published
from oracle_pipeline.datasets import read_table, replacing, write_table
from resources.store import RunStore


def test_places_are_those_that_users_and_tools_call(tmp_path: Path) -> None:
    store = RunStore(root=str(tmp_path))
    run = store.run("fake_object|run003")
    places = [run.path, store.dataset("features"), store.report]
    assert [str(place.relative_to(tmp_path)) for place in places] == [
        "runs/fake_object/run003",
        "datasets/features.parquet",
        "report/index.html",
    ]


def test_a_new_root_is_created_empty(tmp_path: Path) -> None:
    store = RunStore(root=str(tmp_path / "new" / "root"))
    store.require_writable()
    assert list(store.path.iterdir()) == []


@pytest.mark.parametrize("root", ["/proc/oracle", "/dev/null/oracle"])
def test_the_error_for_an_unwritable_root_states_a_remedy(root: str) -> None:
    with pytest.raises(dg.Failure, match=f"{root}.*ORACLE_HOME"):
        RunStore(root=root).require_writable()


@pytest.fixture
def bucket(tmp_path: Path) -> RunStore:
    """A root in an object store; that one lives in memory."""
    return RunStore(root=f"memory://{tmp_path.name}/campaign")


def write(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(name.encode())


def objects(folder: Path) -> dict[str, Any]:
    """Objects in a folder of the bucket, by name, with their times."""
    store, prefix = folder.fs, folder.path  # type: ignore[attr-defined]
    found = store.find(prefix, detail=True)
    return {name.removeprefix(f"{prefix}/"): entry["created"] for name, entry in found.items()}


def test_a_bucket_has_the_places_of_a_folder(bucket: RunStore, tmp_path: Path) -> None:
    folder = RunStore(root=str(tmp_path))
    for place in (lambda s: s.run("fake_object|run003").bag, lambda s: s.dataset("features"),
                  lambda s: s.results("a"), lambda s: s.report):  # fmt: skip
        there, here = place(bucket), place(folder)
        assert str(there).removeprefix(bucket.root) == str(here).removeprefix(folder.root)
    assert (bucket.is_local, folder.is_local) == (False, True)


def test_a_folder_is_read_and_written_where_it_is(tmp_path: Path) -> None:
    with fetched(tmp_path) as read, published(tmp_path / "report", last="x") as written:
        assert (read, written) == (tmp_path, tmp_path / "report")


def test_exactly_the_published_files_are_fetched(bucket: RunStore) -> None:
    place = bucket.results("a")
    with published(place, last="summary.json") as folder:
        write(folder, "summary.json", "figures/old.png")
    with published(place, last="summary.json") as folder:
        write(folder, "summary.json", "figures/new.png", "figures/of/runs.png")
    with fetched(place) as folder:
        names = {path.relative_to(folder).as_posix() for path in folder.rglob("*.*")}
        assert (folder / "figures/of/runs.png").read_bytes() == b"figures/of/runs.png"
    assert names == {"summary.json", "figures/new.png", "figures/of/runs.png"}
    assert not folder.exists()


def test_the_completion_marker_is_published_last(bucket: RunStore) -> None:
    place = bucket.results("a")
    for _ in range(2):  # new, and in the place of a former one
        with published(place, last="b.json") as folder:
            write(folder, "a.json", "b.json", "c.json")
        came = objects(place)
        assert max(came, key=lambda name: came[name]) == "b.json"


def test_a_block_that_raises_publishes_nothing(bucket: RunStore) -> None:
    place = bucket.results("a")
    with published(place, last="b.json") as folder:
        write(folder, "a.json", "b.json")
    before = objects(place)
    with suppress(ZeroDivisionError), published(place, last="b.json") as folder:
        write(folder, "a.json")
        _ = 1 / 0
    assert objects(place) == before


def test_a_table_in_a_bucket_is_replaced_as_a_whole(bucket: RunStore) -> None:
    place = bucket.dataset("features")
    df = pd.DataFrame({"contextual.speed": [1.0, float("nan")]})
    df.attrs["fields"] = {"contextual.speed": {"unit": "m/s"}}
    write_table(df, place)
    with suppress(ZeroDivisionError), replacing(place) as sink:
        sink.write(b"half of")
        _ = 1 / 0
    read = read_table(place)
    pd.testing.assert_frame_equal(read, df)
    assert read.attrs == df.attrs


def test_the_error_for_an_unknown_kind_of_root_states_a_remedy() -> None:
    with pytest.raises(dg.Failure, match="nosuch://bucket.*ORACLE_HOME"):
        RunStore(root="nosuch://bucket").require_writable()
