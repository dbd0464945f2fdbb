"""Dagster's events in SQLite: commits do not wait, and other programs read them at once."""

import subprocess
import sys
from pathlib import Path

import dagster as dg
import pytest
import sqlalchemy as sa

from resources.bulk_commits import OPEN_DATABASES, commit_in_bulk
from tests.instances import instance_of, make_home

COUNT = """
import sys, dagster as dg
with dg.DagsterInstance.from_config(sys.argv[1]) as instance:
    print(len(instance.fetch_materializations(dg.AssetKey("one"), limit=100).records))
"""


@dg.asset(check_specs=[dg.AssetCheckSpec("is_positive", asset="one")])
def one():  # type: ignore[no-untyped-def]
    yield dg.MaterializeResult(metadata={"figure": 3})
    yield dg.AssetCheckResult(check_name="is_positive", passed=True)


@pytest.fixture(autouse=True)
def bulk() -> None:
    """As when the code location is loaded."""
    commit_in_bulk()


def test_another_program_reads_the_events_of_an_open_instance(tmp_path: Path) -> None:
    home = make_home(tmp_path)
    with instance_of(home) as instance:
        for _ in range(2):
            assert dg.materialize([one], instance=instance).success
        counted = subprocess.run(
            [sys.executable, "-c", COUNT, str(home)],
            capture_output=True, text=True, check=True,
            env={"DAGSTER_HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[2])},
        )  # fmt: skip
        records = instance.fetch_materializations(one.key, limit=100).records
        assert int(counted.stdout) == len(records) == 2


def test_commits_and_closes_do_not_wait_for_the_disk(tmp_path: Path) -> None:
    """The write-ahead log stays when a connection closes: nothing was copied to the database."""
    engine = sa.create_engine(f"sqlite:///{tmp_path / 'events.db'}", poolclass=sa.NullPool)
    with engine.begin() as first:
        first.exec_driver_sql("PRAGMA journal_mode=WAL")
        first.exec_driver_sql("CREATE TABLE event (id INTEGER)")
    for number in range(3):
        with engine.begin() as each:
            assert each.exec_driver_sql("PRAGMA synchronous").scalar() == 1  # NORMAL
            each.exec_driver_sql("INSERT INTO event VALUES (?)", (number,))
        if number:  # the second connection finds the log
            assert (tmp_path / "events.db-wal").stat().st_size > 0


def test_few_databases_stay_open_and_those_of_all_runs_are_readable(tmp_path: Path) -> None:
    with instance_of(make_home(tmp_path)) as instance:
        runs = [dg.materialize([one], instance=instance).run_id for _ in range(OPEN_DATABASES + 2)]
        assert all(instance.get_run_step_stats(run) for run in runs)
        files = {str(entry.resolve()) for entry in Path("/proc/self/fd").iterdir()}
        databases = [file for file in files if str(tmp_path) in file and file.endswith(".db")]
        assert 0 < len(databases) <= OPEN_DATABASES
