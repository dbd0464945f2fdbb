"""A version changes with the code that a result depends on, and with no other."""

import shutil

import pytest

from assets.worker.versions import analysis_code, feature_code
from oracle_pipeline.bags.sources import PACKAGES, ROOT
from sim.software import run_code
from sim.testbeds import TESTBEDS


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of our packages."""
    root = tmp_path_factory.mktemp("tree")
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    return root


@pytest.fixture(scope="module")
def before(tree):
    return versions(tree)


def versions(root):
    feature_code.cache_clear()
    analysis_code.cache_clear()
    return {
        "robot": run_code([TESTBEDS["turtlebot3"].made_by], root),
        "flights": run_code([TESTBEDS["atc"].made_by], root),
        "features": feature_code(root),
        "evaluation": analysis_code("assets.oracle_evaluation", root),
        "reports": analysis_code("assets.oracle_report", root),
    }


ROBOT, FLIGHTS, FEATURES = {"robot"}, {"flights"}, {"features"}
RUNS = ROBOT | FLIGHTS
ANALYSES = {"evaluation", "reports"}
NOTHING: set[str] = set()
UNRELATED = (
    "sim/commands/record.py",
    "sim/commands/progress.py",
    "sim/fan_out.py",
    "sim/worker_pool.py",
    "resources/fleet.py",
    "sim/scenarios/random_noise.yaml",
    "sim/modes.py",
    "sim/experiments.py",
    "sim/turtlebot3/drawing.py",
    "assets/experiment_runs.py",
    "sim/atc/testbed.py",
    "oracle_pipeline/cli.py",
    "oracle_pipeline/replay/replay_command.py",
)


@pytest.mark.parametrize(
    ("place", "changed"),
    [
        ("sim/turtlebot3/recipes.py", ROBOT),
        ("sim/recording.py", RUNS),
        ("sim/nav2/amcl.py", ROBOT),
        ("sim/atc/fusion.py", FLIGHTS),
        ("sim/fuzzing/operators.py", RUNS),
        ("sim/fuzzing/scenario.schema.json", RUNS),
        ("oracle_pipeline/bags/writer.py", RUNS | FEATURES | ANALYSES),  # logs are written as bags
        ("oracle_pipeline/windows.py", FEATURES | ANALYSES),
        ("oracle_pipeline/bags/protocol.py", RUNS | FEATURES | ANALYSES),
        ("oracle_pipeline/datasets.py", FEATURES | ANALYSES),
        ("oracle_pipeline/opened_run.py", FEATURES | ANALYSES),
        ("oracle_pipeline/bags/jit.py", RUNS | FEATURES | ANALYSES),
        ("oracle_pipeline/features/lidar/scan.py", FEATURES | ANALYSES),
        ("oracle_pipeline/graphs/views.py", FEATURES | ANALYSES),
        ("oracle_pipeline/bags/reader.py", FEATURES | ANALYSES),
        ("oracle_pipeline/bags/manifest.schema.json", RUNS | FEATURES | ANALYSES),
        ("oracle_pipeline/evaluation/metrics.py", ANALYSES),
        ("oracle_pipeline/reporting/templates/report.html.j2", ANALYSES),
        ("oracle_pipeline/reporting/html.py", {"reports"}),
        ("assets/oracle_evaluation.py", {"evaluation"}),
    ],
)
def test_a_change_changes_the_versions_of_what_depends_on_it(tree, before, place, changed):
    assert changed_by(tree, before, [place]) == changed


def test_what_no_result_depends_on_changes_no_version(tree, before):
    assert changed_by(tree, before, UNRELATED) == NOTHING


def test_comments_and_docstrings_leave_all_recorded_runs_and_features_current(tree, before):
    places = ["sim/atc/tcas.py", "oracle_pipeline/features/lidar/scan.py"]
    added = '# Why.\n"""What is above."""\n\n\n'
    assert changed_by(tree, before, places, added) == NOTHING


def changed_by(tree, before, places, added=None):
    """Return which versions change when something is added to files."""
    sources = {tree / place: (tree / place).read_text() for place in places}
    for file, source in sources.items():
        file.write_text(source + (added or ("CHANGED = True\n" if file.suffix == ".py" else "\n")))
    after = versions(tree)
    for file, source in sources.items():
        file.write_text(source)
    return {name for name in before if before[name] != after[name]}


def test_a_line_of_the_users_plugin_folder_changes_the_features(
    tree, before, tmp_path, monkeypatch
):
    (tmp_path / "mine.py").write_text("LIMIT = 1\n")
    monkeypatch.setenv("ORACLE_PLUGINS", str(tmp_path))
    one = versions(tree)
    (tmp_path / "mine.py").write_text("LIMIT = 2\n")
    other = versions(tree)
    feature_code.cache_clear()
    assert len({before["features"], one["features"], other["features"]}) == 3
    assert {**before, "features": ""} == {**one, "features": ""} == {**other, "features": ""}
