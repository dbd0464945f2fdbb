"""Dagster from the command line, in a checkout with its `.env`: a range, and the UI."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import dagster as dg
import pytest

from tests.assets.laboratory import ATTACKED, KEYS, ROOT, Laboratory, dagster_home
from tests.instances import instance_of
from tests.servers import end_with_parent

pytestmark = pytest.mark.slow(10)

BIN = Path(sys.executable).parent
MATERIALIZE = ["dagster", "asset", "materialize", "-m", "oracle_pipeline.definitions"]


@pytest.fixture
def checkout(campaign: Laboratory, tmp_path: Path) -> Path:
    """The files that commands read, and the runs of the short campaign."""
    for file in (".env", "workspace.yaml", ".dagster_home/dagster.yaml"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    for part in ("runs", "features"):
        shutil.copytree(campaign.root / part, tmp_path / "data" / part)
    return tmp_path


def environment(checkout: Path) -> dict[str, str]:
    """The environment of a shell in the checkout."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith("ORACLE_")}
    return ours | {
        "PWD": str(checkout),
        "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
        "ORACLE_GOALS_PER_RUN": "1",
    }


def run(checkout: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=checkout,
        env=environment(checkout),
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_range_is_one_dagster_run_and_names_failed_runs(checkout: Path) -> None:
    (checkout / "data/runs" / ATTACKED / "run001" / "manifest.json").write_text("{}")
    done = run(
        checkout, *MATERIALIZE, "--select", "+run_features", "--partition-range",
        f"{KEYS[2]}...{KEYS[3]}",
    )  # fmt: skip
    assert done.returncode == 1
    assert "run/s" not in done.stderr  # no progress bar: this is no terminal
    assert "1 of 2 runs failed" in done.stderr + done.stdout
    assert f"{KEYS[3]}: " in done.stderr + done.stdout
    with dagster_home(checkout / ".dagster_home") as instance:
        assert instance.get_materialized_partitions(dg.AssetKey("run_features")) == {KEYS[2]}
        assert len(instance.get_run_records()) == 1


def test_the_ui_comes_up(checkout: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "assets.webserver", "-w", "workspace.yaml", "-p", str(port)]
    with (checkout / "log").open("w") as log:
        server = subprocess.Popen(
            command, cwd=checkout, env=environment(checkout), stdout=log, stderr=log,
            start_new_session=True, preexec_fn=hear_control_c_and_end_with_parent,
        )  # fmt: skip
        try:
            answer = wait_for(f"http://127.0.0.1:{port}/server_info", seconds=180)
            wait_for_daemon(checkout / ".dagster_home", seconds=180)
        finally:
            os.killpg(server.pid, signal.SIGINT)
            server.wait(timeout=180)
    said = (checkout / "log").read_text()
    assert answer["dagster_version"].startswith("1.13"), said
    assert server.returncode == 0, said
    assert "Traceback" not in said
    assert "Daemon threads shut down" in said
    assert left_of(server.pid, seconds=20) == []


def hear_control_c_and_end_with_parent() -> None:
    """Restore the interrupt signal, which jobs in a shell's background ignore."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    end_with_parent()()


def wait_for_daemon(home: Path, seconds: float) -> None:
    until = time.monotonic() + seconds
    with instance_of(home) as instance:
        while "QUEUED_RUN_COORDINATOR" not in instance.get_daemon_heartbeats():
            assert time.monotonic() < until
            time.sleep(0.2)


def left_of(group: int, seconds: float) -> list[int]:
    """Return the processes of a group or session that outlive it by so much time."""
    until = time.monotonic() + seconds
    while (left := processes_of(group)) and time.monotonic() < until:
        time.sleep(0.1)
    return left


def processes_of(group: int) -> list[int]:
    """Return the processes of a group or session that live: a server's children."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            state, parent, its_group = stat.read_text().rpartition(")")[2].split()[:3]
            if state != "Z" and group in (int(parent), int(its_group)):
                found.append(int(stat.parent.name))
    return found


def wait_for(url: str, seconds: float) -> dict[str, str]:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        try:
            with urllib.request.urlopen(url) as response:  # noqa: S310
                found: dict[str, str] = json.load(response)
                return found
        except urllib.error.URLError:
            time.sleep(0.2)
    raise TimeoutError(f"{url} did not answer within {seconds} s")
