"""The run store: its layout, and what it says when it cannot be written to."""

from pathlib import Path

import dagster as dg
import pytest

from resources.store import RunStore


def test_places_are_those_that_users_and_tools_call(tmp_path: Path) -> None:
    store = RunStore(root=str(tmp_path))
    run = store.run("fake_object|run003")
    places = [
        run.path,
        store.dataset("features"),
        store.report,
    ]
    assert [str(place.relative_to(tmp_path)) for place in places] == [
        "runs/fake_object/run003",
        "datasets/features.parquet",
        "report/index.html",
    ]


def test_a_new_root_is_made_and_left_empty(tmp_path: Path) -> None:
    store = RunStore(root=str(tmp_path / "new" / "root"))
    store.require_writable()
    assert list(store.path.iterdir()) == []


@pytest.mark.parametrize("root", ["/proc/oracle", "/dev/null/oracle"])
def test_a_root_that_cannot_be_written_to_is_named_with_a_way_out(root: str) -> None:
    with pytest.raises(dg.Failure, match=f"{root}.*ORACLE_HOME"):
        RunStore(root=root).require_writable()
