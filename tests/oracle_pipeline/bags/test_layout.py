"""The layout of a root: every file of a run is assigned to it."""

from pathlib import Path

import pytest

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.run_directory import RunDirectory

ROOT = Path("root")
RUN = RunDirectory(ROOT, "fake_object", 3)


@pytest.mark.parametrize(
    ("file", "part"),
    [
        (RUN.manifest_path, "manifest.json"),
        (RUN.bag / "bag_0.mcap", "bag"),
        (RUN.graphs / "000010.gexf", "graphs"),
        (RUN.feature_table("run"), "features"),
        (RUN.feature_table("window").with_suffix(".json"), "features"),
    ],
)
def test_a_file_of_a_run_belongs_to_that_run(file: Path, part: str) -> None:
    owner = layout.owner(file.relative_to(ROOT).parts)
    assert owner == (RUN.mode, RUN.run_id, part)


@pytest.mark.parametrize(
    "file",
    [
        layout.dataset(ROOT, "features"),
        layout.report_page(ROOT),
        layout.report_part(ROOT, "oracle_evaluation") / "summary.json",
        layout.grid_root(ROOT, "noise") / "runs" / "noise" / "run000" / "manifest.json",
        ROOT / layout.REFRESHED / "runs" / "noise" / "run000" / "manifest.json",
        ROOT / layout.RUNS / "noise" / "notes.txt",
    ],
)
def test_a_file_of_the_root_belongs_to_no_run(file: Path) -> None:
    assert layout.owner(file.relative_to(ROOT).parts) is None


def test_tables_and_grids_are_found_where_they_are_put(tmp_path: Path) -> None:
    tables = [RunDirectory(tmp_path, mode, 0).feature_table("run") for mode in ("b", "a")]
    index = layout.grid_root(tmp_path, "noise") / layout.GRID_INDEX
    for file in (*tables, index, RunDirectory(tmp_path, "a", 0).feature_table("window")):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    assert layout.feature_tables(tmp_path, "run") == sorted(tables)
    assert layout.grid_indices(tmp_path) == [index]
