"""Dagster's events in SQLite: other programs read at once what is stored."""

import subprocess
import sys
from pathlib import Path

import dagster as dg

from resources.event_storage import OPEN_DATABASES
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


def count(instance: dg.DagsterInstance) -> int:
    return len(instance.fetch_materializations(one.key, limit=100).records)


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
        assert int(counted.stdout) == count(instance) == 2


def test_dagsters_own_storage_and_ours_read_each_others_events(tmp_path: Path) -> None:
    home = make_home(tmp_path)
    with instance_of(home) as ours:
        assert dg.materialize([one], instance=ours).success
    (home / "dagster.yaml").write_text("telemetry: {enabled: false}\n")
    with dg.DagsterInstance.from_config(str(home)) as theirs:
        assert type(theirs.event_log_storage) is not type(ours.event_log_storage)
        assert dg.materialize([one], instance=theirs).success
        assert count(theirs) == 2
    with instance_of(make_home(home)) as ours:
        assert count(ours) == 2
        assert ours.get_runs_count() == 2


def test_few_databases_stay_open_and_those_of_all_runs_are_readable(tmp_path: Path) -> None:
    with instance_of(make_home(tmp_path)) as instance:
        runs = [dg.materialize([one], instance=instance).run_id for _ in range(OPEN_DATABASES + 2)]
        assert all(instance.get_run_step_stats(run) for run in runs)
        files = {str(entry.resolve()) for entry in Path("/proc/self/fd").iterdir()}
        databases = [file for file in files if str(tmp_path) in file and file.endswith(".db")]
        assert 0 < len(databases) <= OPEN_DATABASES
