"""Our commands use the project's own Dagster instance, wherever a program starts them from."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.instances import instance_of

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).parent.parent
BIN = Path(sys.executable).parent
RUN = ["dagster", "job", "execute", "-f", "nothing.py", "-j", "nothing"]
NOTHING = """
import dagster as dg

@dg.op
def nothing_to_do():
    pass

@dg.job(executor_def=dg.in_process_executor)
def nothing():
    nothing_to_do()
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    place = tmp_path / "checkout"
    (place / ".dagster_home").mkdir(parents=True)
    for name in (".env", "workspace.yaml", "Makefile", ".dagster_home/dagster.yaml"):
        shutil.copy(REPOSITORY / name, place / name)
    (place / "nothing.py").write_text(NOTHING)
    return place


def call(
    *command: str, cwd: Path, stale: Path | None, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Start a command as a program does: with a PWD that a shell elsewhere has left, or none."""
    ours = {"PWD", "DAGSTER_HOME", "ORACLE_DAGSTER_HOME"}
    environment = {name: value for name, value in os.environ.items() if name not in ours}
    environment |= {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", **variables}
    if stale is not None:
        environment["PWD"] = str(stale)
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


def runs_of(home: Path) -> int:
    with instance_of(home) as instance:
        return instance.get_runs_count()


@pytest.mark.parametrize("stale", [True, False], ids=["stale", "missing"])
def test_dagster_in_the_folder_uses_its_instance(
    checkout: Path, tmp_path: Path, stale: bool
) -> None:
    done = call(*RUN, cwd=checkout, stale=tmp_path if stale else None)
    assert done.returncode == 0, done.stderr
    assert runs_of(checkout / ".dagster_home") == 1


def test_where_there_is_no_proc_a_variable_names_the_instance(
    checkout: Path, tmp_path: Path
) -> None:
    home = tmp_path / "home"
    shutil.copytree(checkout / ".dagster_home", home)
    done = call(*RUN, cwd=checkout, stale=tmp_path, ORACLE_DAGSTER_HOME=str(home))
    assert done.returncode == 0, done.stderr
    assert runs_of(home) == 1
    assert runs_of(checkout / ".dagster_home") == 0


def test_make_from_another_folder_names_the_instance_of_the_project(
    checkout: Path, tmp_path: Path
) -> None:
    with (checkout / "Makefile").open("a") as makefile:
        makefile.write("\nshow:\n\t@echo $$DAGSTER_HOME $$ORACLE_DAGSTER_HOME\n")
    done = call("make", "-s", "-C", str(checkout), "show", cwd=tmp_path, stale=tmp_path)
    home = str(checkout / ".dagster_home")
    assert done.stdout.split() == [home, home], done.stderr


@pytest.mark.parametrize(
    "command", [["oracle", "--help"], ["oracle-sim", "--help"], ["oracle-ui", "--help"]]
)
def test_our_commands_start_in_any_folder(tmp_path: Path, command: list[str]) -> None:
    done = call(*command, cwd=tmp_path, stale=REPOSITORY)
    assert done.returncode == 0, done.stderr
