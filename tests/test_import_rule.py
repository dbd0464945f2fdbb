"""Imports go one way only: the contracts in pyproject.toml, which import-linter checks."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
PACKAGES = ("oracle_pipeline", "assets", "resources", "sim")
LINTER = Path(sys.executable).with_name("lint-imports")


@pytest.fixture
def tree(tmp_path):
    """A copy of the four packages, to break the rule in."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    return tmp_path


def lint(tree):
    return subprocess.run(
        [LINTER, "--no-logo", "--no-cache"], cwd=tree, capture_output=True, text=True, check=False
    )


def test_the_tree_keeps_the_rule(tree):
    done = lint(tree)
    assert done.returncode == 0, done.stdout


FORBIDDEN = [
    (
        "sim/recording.py",
        "from oracle_pipeline.graphs import views",
        "oracle_pipeline.graphs.views",
    ),
    (
        "sim/recording.py",
        "def late():\n    from oracle_pipeline.features import manager",
        "oracle_pipeline.features.manager",
    ),
    ("sim/nav2/amcl.py", "import dagster as dg", "dagster"),
    ("oracle_pipeline/graphs/views.py", "from sim.modes import PAIRS", "sim.modes"),
    ("oracle_pipeline/graphs/views.py", "import mujoco", "mujoco"),
    ("oracle_pipeline/bags/reader.py", "from .. import datasets", "oracle_pipeline.datasets"),
    ("oracle_pipeline/cli.py", "from .definitions import defs", "oracle_pipeline.definitions"),
    ("resources/store.py", "from assets.partitions import RUNS", "assets.partitions"),
    (
        "assets/experiment_runs.py",
        "from oracle_pipeline.definitions import defs",
        "oracle_pipeline.definitions",
    ),
    ("assets/worker/run.py", "def late():\n    import dagster", "dagster"),
    ("resources/storage/plan.py", "from resources.store import RunStore", "resources.store"),
    ("sim/nav2/amcl.py", "from sim.atc import tcas", "sim.atc.tcas"),
]


def test_the_rule_names_everything_that_it_forbids(tree):
    """All at once: to build the graph of imports takes seconds."""
    for file, statement, _ in FORBIDDEN:
        with (tree / file).open("a", encoding="utf-8") as module:
            module.write(f"\n{statement}\n")
    done = lint(tree)
    assert done.returncode == 1
    for file, _, imported in FORBIDDEN:
        module = file.removesuffix(".py").replace("/", ".")
        assert re.search(rf"{re.escape(module)} -> {re.escape(imported)} \(l", done.stdout), file


def test_private_names_of_dagster_are_imported_only_by_modules_of_that_name():
    private = re.compile(r"^\s*(?:from|import) dagster\._", re.MULTILINE)
    found = {
        path.relative_to(ROOT).as_posix()
        for folder in (*PACKAGES, "tools", "tests")
        for path in (ROOT / folder).rglob("*.py")
        if private.search(path.read_text(encoding="utf-8"))
    }
    assert found == {
        "resources/dagster_internals.py",
        "assets/webserver/dagster_internals.py",
        "tests/assets/dagster_internals.py",
    }
