"""Several runs in a partition: the same runs and features, in fewer events and files."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from oracle_pipeline.bags.run_directory import RunDirectory
from tests.assets.laboratory import PER_RUN, ROOT

pytestmark = pytest.mark.slow

MODE = "atc_normal"
FIRST, LAST = f"{MODE}|run000-001", f"{MODE}|run002"  # three runs, two in a partition


def materialized(folder: Path, first: str, last: str, together: int) -> dict[str, Any]:
    """Materialize a range in another process; return what `partition_of_runs` prints."""
    settings = {"ORACLE_RUNS": "3", "ORACLE_RUNS_PER_PARTITION": str(together)}
    done = subprocess.run(
        [sys.executable, "-m", "tests.assets.partition_of_runs", str(folder), first, last],
        env={**os.environ, **settings, "ORACLE_MODES": MODE}, cwd=ROOT,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_runs_of_a_partition_fail_alone_and_their_tables_are_one_file(tmp_path: Path) -> None:
    root = tmp_path / "data"
    bad = RunDirectory(root, MODE, 1)
    bad.path.mkdir(parents=True)
    bad.manifest_path.write_text("{}")  # what exists is not overwritten

    left = materialized(tmp_path, FIRST, LAST, together=2)
    assert not left["success"]
    assert list(left["figures"]) == [FIRST, LAST]
    for asset in PER_RUN:
        of_two = left["figures"][FIRST][asset]
        assert (of_two["runs"], of_two["failed"], of_two["status"]) == (1, "run001", "1 made")

    shutil.rmtree(bad.path)
    left = materialized(tmp_path, FIRST, LAST, together=2)
    assert left["success"]
    of_two = left["figures"][FIRST]["run_features"]
    assert (of_two["runs"], of_two["dagster/row_count"]) == (2, 2)
    assert of_two["status"] == "1 verified, 1 made"
    assert of_two["path"] == str(root / "features/run" / MODE / "run000-001.parquet")
    for table in ("run", "window"):
        files = {file.name for file in (root / "features" / table / MODE).glob("*.parquet")}
        assert files == {"run000-001.parquet", "run002.parquet"}
    assert all(passed for _, _, passed in left["checks"])
    assert {partition for partition, _, _ in left["checks"]} == {FIRST, LAST}

    # Partitions of one run find their rows in the joined files, and give the same dataset.
    single = materialized(tmp_path, f"{MODE}|run000", LAST, together=1)
    assert single["success"]
    assert single["dataset"] == left["dataset"]
    for key in (f"{MODE}|run000", f"{MODE}|run001", LAST):
        assert single["figures"][key]["run_features"]["status"] == "verified"
        assert single["figures"][key]["run_features"]["dagster/row_count"] == 1
