"""The commands that the README and the design promise, as a person types them."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main as oracle
from resources.cli import main as oracle_sim

REPOSITORY = Path(__file__).parent.parent
BIN = Path(sys.executable).parent
MATERIALIZE = ("dagster", "asset", "materialize", "-m", "oracle_pipeline.definitions", "--select")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder like a checkout's: `.env` there decides where Dagster keeps its instance."""
    root = tmp_path_factory.mktemp("checkout")
    (root / ".dagster_home").mkdir()
    for name in (".env", "workspace.yaml", ".dagster_home/dagster.yaml"):
        shutil.copy(REPOSITORY / name, root / name)
    return root


def command(place, *words, expect=0):
    environment = {
        **os.environ,
        "PATH": f"{BIN}:{os.environ['PATH']}",
        "ORACLE_HOME": str(place / "data"),
        "ORACLE_GOALS_PER_RUN": "1",
    }
    done = subprocess.run(
        words, cwd=place, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == expect, done.stdout + done.stderr
    return done


def test_one_partition_goes_through_everything(place):
    command(place, *MATERIALIZE, "*", "--partition", "fake_object|run003")
    assert (place / "data/runs/fake_object/run003/manifest.json").is_file()
    assert (place / "data/features/run/fake_object/run003.parquet").is_file()
    assert (place / "data/report/index.html").is_file()


def test_an_unknown_partition_is_refused(place):
    done = command(place, *MATERIALIZE, "experiment_runs", "--partition", "fake|run000", expect=1)
    assert "fake|run000" in done.stdout + done.stderr


def test_features_of_a_run_directory_and_of_its_bag_alone(place):
    run = place / "data/runs/fake_object/run003"
    of_run = json.loads(command(place, "oracle", "features", str(run)).stdout)
    of_bag = json.loads(command(place, "oracle", "features", str(run / "bag")).stdout)
    assert of_run
    assert of_bag


def test_a_run_is_replayed_beside_its_manifest(place):
    run = place / "data/runs/fake_object/run003"
    command(place, "oracle", "replay", str(run))
    assert (run / "replay.gif").read_bytes().startswith(b"GIF89a")
    assert (run / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_a_file_that_is_no_recording_is_refused_in_one_line(place):
    done = command(place, "oracle", "features", str(REPOSITORY / "README.md"), expect=2)
    assert done.stdout == ""
    assert "README.md" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_workspace_loads(place):
    done = command(place, "dagster", "definitions", "validate", "-w", "workspace.yaml")
    assert "Validation successful for code location oracle" in done.stdout + done.stderr


def test_make_help_lists_what_the_readme_promises(place):
    listed = set(
        re.findall(
            r"^  make (\w+)", command(place, "make", "-C", str(REPOSITORY), "help").stdout, re.M
        )
    )
    promised = set(re.findall(r"^make (\w+)", (REPOSITORY / "README.md").read_text(), re.M))
    assert promised <= listed


@pytest.mark.parametrize(("tool", "group"), [("oracle", oracle), ("oracle-sim", oracle_sim)])
def test_help_names_every_command_with_a_line_about_it(place, tool, group):
    text = command(place, tool, "--help").stdout
    commands = re.findall(r"^  (\w+) {2,}(\S.*)$", text.partition("Commands:")[2], re.M)
    assert commands
    for name, about in commands:
        assert len(about) > 20
        assert "Example" in CliRunner().invoke(group, [name, "--help"]).stdout
