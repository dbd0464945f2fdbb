"""A Dagster run whose process was killed is marked as failed, and does not block the queue."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import dagster as dg
import pytest

from resources.run_processes import fail_lost_runs, hold
from tests.instances import instance_of, make_home
from tests.servers import ROOT, end_with_parent, process, wait_until
from tests.ui import NOTHING, WORKSPACE

pytestmark = pytest.mark.slow(6)

FAILED, STARTED = dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.STARTED
SUCCEEDED = dg.DagsterRunStatus.SUCCESS
MODULE = ["-m", "oracle_pipeline.definitions"]
HOLD = """
import sys, time, dagster as dg
from resources.run_processes import hold
with dg.DagsterInstance.from_config(sys.argv[1]) as instance:
    hold(instance, sys.argv[2])
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def home(tmp_path: Path) -> Path:
    return make_home(tmp_path)


@pytest.fixture
def instance(home: Path) -> Iterator[dg.DagsterInstance]:
    with instance_of(home) as found:
        yield found


def started_run(instance: dg.DagsterInstance) -> str:
    """A run that Dagster considers started."""
    run = instance.create_run_for_job(dg.GraphDefinition(name="anything").to_job())
    instance.report_dagster_event(
        dg.DagsterEvent(dg.DagsterEventType.RUN_START.value, run.job_name), run.run_id
    )
    assert status(instance, run.run_id) == STARTED
    return run.run_id


def status(instance: dg.DagsterInstance, run_id: str) -> dg.DagsterRunStatus:
    run = instance.get_run_by_id(run_id)
    assert run is not None
    return run.status


def reasons(instance: dg.DagsterInstance, run_id: str) -> list[str]:
    failures = instance.all_logs(run_id, of_type=dg.DagsterEventType.RUN_FAILURE)
    return [event.dagster_event.message or "" for event in failures if event.dagster_event]


def kill(of_run: "subprocess.Popen[bytes]") -> None:
    """End a process, and all that it has started, as the kernel does when memory is short."""
    os.killpg(of_run.pid, signal.SIGKILL)
    of_run.wait()


def materialize(home: Path, partition: str) -> "subprocess.Popen[bytes]":
    command = ["asset", "materialize", *MODULE, "--select", "experiment_runs",
               "--partition", partition]  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-m", "dagster", *command],
        cwd=home,
        env=environment(home),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=end_with_parent(),
    )


def environment(home: Path) -> dict[str, str]:
    ours = {"DAGSTER_HOME": str(home), "ORACLE_HOME": str(home / "data"), "PYTHONPATH": str(ROOT)}
    return os.environ | ours


def test_two_killed_commands_do_not_block_the_queue(
    home: Path, instance: dg.DagsterInstance
) -> None:
    killed = [materialize(home, f"lidar_passthrough|run00{number}") for number in (0, 1)]
    log = home / "log"
    log.touch()
    wait_until(lambda: len(instance.get_runs(dg.RunsFilter(statuses=[STARTED]))) == 2, log)
    time.sleep(1.0)  # somewhere in the step
    for each in killed:
        kill(each)
    lost = [run.run_id for run in instance.get_runs()]
    assert [status(instance, run) for run in lost] == [STARTED, STARTED]
    (home / "definitions.py").write_text(NOTHING)
    (home / "workspace.yaml").write_text(WORKSPACE)
    workspace = ["-w", "workspace.yaml"]
    subprocess.run(
        [sys.executable, "-m", "dagster", "job", "launch", *workspace, "-j", "nothing"],
        cwd=home, env=environment(home), check=True, capture_output=True,
    )  # fmt: skip
    (waiting,) = {run.run_id for run in instance.get_runs()} - set(lost)
    with process(["dagster._daemon", "run", *workspace], log, environment(home)):
        wait_until(lambda: status(instance, waiting) == SUCCEEDED, log)
    for run in lost:
        assert status(instance, run) == FAILED
        (reason,) = reasons(instance, run)
        assert "process" in reason
        assert "is gone" in reason


def test_the_next_command_marks_lost_runs_as_failed(
    home: Path, instance: dg.DagsterInstance
) -> None:
    lost, other = started_run(instance), started_run(instance)
    command = [sys.executable, "-c", HOLD, str(home), lost]
    with subprocess.Popen(
        command,
        env=environment(home),
        stdout=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=end_with_parent(),
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        assert fail_lost_runs(instance) == []
        kill(holder)
    subprocess.run(
        [sys.executable, "-m", "dagster", "job", "execute", *MODULE, "-j", "evaluate"],
        cwd=home, env=environment(home), check=False, capture_output=True,
    )  # fmt: skip
    assert status(instance, lost) == FAILED
    assert status(instance, other) == STARTED
    left = {file.name for file in (home / "run_processes").iterdir()}
    assert lost not in left


def test_a_reused_process_id_is_not_mistaken_for_the_run(
    home: Path, instance: dg.DagsterInstance
) -> None:
    lost = started_run(instance)
    (home / "run_processes").mkdir()
    alive = f"process {os.getpid()} on this machine"  # a living process has this number
    (home / "run_processes" / lost).write_text(alive)
    assert fail_lost_runs(instance) == [lost]
    assert alive in reasons(instance, lost)[0]


def test_a_run_of_another_machine_is_ignored(instance: dg.DagsterInstance, tmp_path: Path) -> None:
    elsewhere = started_run(instance)  # its file is below the folder of that machine's instance
    assert fail_lost_runs(instance) == []
    here = started_run(instance)
    hold(instance, here)
    assert fail_lost_runs(instance) == []
    assert [status(instance, run) for run in (elsewhere, here)] == [STARTED, STARTED]
