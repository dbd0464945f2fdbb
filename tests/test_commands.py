"""The commands that the README and the design promise, as a person types them."""

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from assets.oracle_sim import main as oracle_sim
from assets.webserver.server import main as oracle_ui
from oracle_pipeline.cli import main as oracle
from tests.recorded_runs import copied

pytestmark = pytest.mark.slow(4)

REPOSITORY = Path(__file__).parent.parent
BIN = Path(sys.executable).parent
MATERIALIZE = ("asset", "materialize", "-m", "oracle_pipeline.definitions", "--select")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder like a checkout's: `.env` there decides where Dagster keeps its instance."""
    root = tmp_path_factory.mktemp("checkout")
    (root / ".dagster_home").mkdir()
    for name in (".env", "workspace.yaml", ".dagster_home/dagster.yaml"):
        shutil.copy(REPOSITORY / name, root / name)
    return root


def environment(place):
    return {
        "PATH": f"{BIN}:{os.environ['PATH']}",
        "ORACLE_HOME": str(place / "data"),
        "ORACLE_GOALS_PER_RUN": "1",
    }


def command(place, *words):
    done = subprocess.run(
        words, cwd=place, env=os.environ | environment(place), capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def in_process(group, *words, expect=0):
    """Run a command in this process, since a start of Python takes seconds."""
    done = CliRunner().invoke(group, [str(word) for word in words])
    assert done.exit_code == expect, done.output
    return done


@pytest.fixture
def dagster(place, monkeypatch):
    """The command ``dagster`` in this process, in a checkout's folder."""
    monkeypatch.chdir(place)
    for name, value in environment(place).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("DAGSTER_HOME", str(place / ".dagster_home"))
    (script,) = importlib.metadata.entry_points(group="console_scripts", name="dagster")
    return script.load().__globals__["cli"]


@pytest.fixture
def run(recorded_run, tmp_path):
    return copied(recorded_run("fake_object"), tmp_path).path


def test_one_partition_goes_through_everything(place):
    command(place, "dagster", *MATERIALIZE, "*", "--partition", "random_noise|run001")
    assert (place / "data/runs/random_noise/run001/manifest.json").is_file()
    assert (place / "data/features/run/random_noise/run001.parquet").is_file()
    assert (place / "data/report/index.html").is_file()


def test_an_unknown_partition_is_refused(dagster):
    words = (*MATERIALIZE, "experiment_runs", "--partition", "fake|run000")
    done = in_process(dagster, *words, expect=1)
    assert "fake|run000" in f"{done.output}{done.exception}"


def test_features_of_a_run_directory_and_of_its_bag_alone(run):
    assert json.loads(in_process(oracle, "features", run).stdout)
    assert json.loads(in_process(oracle, "features", run / "bag").stdout)


def test_a_run_is_replayed_beside_its_manifest(run):
    in_process(oracle, "replay", run)
    assert (run / "replay.gif").read_bytes().startswith(b"GIF89a")
    assert (run / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_a_file_that_is_no_recording_is_refused_in_one_line():
    done = in_process(oracle, "features", REPOSITORY / "README.md", expect=2)
    assert done.stdout == ""
    assert "README.md" in done.stderr
    assert isinstance(done.exception, SystemExit)  # and no traceback


def test_the_workspace_loads(dagster, caplog, capfd):
    done = in_process(dagster, "definitions", "validate", "-w", "workspace.yaml")
    said = done.output + capfd.readouterr().err + caplog.text
    assert "Validation successful for code location oracle" in said


def test_make_help_lists_what_the_readme_promises(place):
    listed = set(
        re.findall(
            r"^  make (\w+)", command(place, "make", "-C", str(REPOSITORY), "help").stdout, re.M
        )
    )
    promised = set(re.findall(r"^make (\w+)", (REPOSITORY / "README.md").read_text(), re.M))
    assert promised <= listed


@pytest.mark.parametrize("group", [oracle, oracle_sim])
def test_help_names_every_command_with_a_line_about_it(group):
    text = in_process(group, "--help").stdout
    commands = re.findall(r"^  (\w+) {2,}(\S.*)$", text.partition("Commands:")[2], re.M)
    assert commands
    for name, about in commands:
        assert len(about) > 20
        assert about.endswith(".")
        assert not about.endswith("..."), f"the line about {name} is cut off"
        assert "Example" in CliRunner().invoke(group, [name, "--help"]).stdout


@pytest.mark.parametrize("group", [oracle, oracle_sim, oracle_ui])
def test_every_command_prints_its_version(group):
    assert (
        importlib.metadata.version("ros2-behaviour-oracle") in in_process(group, "--version").stdout
    )
