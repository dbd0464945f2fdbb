"""A version changes with the code that a result depends on, and with no other."""

import shutil

import pytest

from assets.worker.versions import analysis_code, feature_code
from oracle_pipeline.bags.sources import PACKAGES, ROOT
from sim.software import run_code


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
        "runs": run_code(root),
        "features": feature_code(root),
        "evaluation": analysis_code("assets.oracle_evaluation", root),
        "reports": analysis_code("assets.oracle_report", root),
    }


RUNS, FEATURES = {"runs"}, {"features"}
ANALYSES = {"evaluation", "reports"}
NOTHING: set[str] = set()


@pytest.mark.parametrize(
    ("place", "old", "new", "changed"),
    [
        ("sim/commands/record.py", "runs of one mode", "some runs of a mode", NOTHING),
        ("sim/commands/progress.py", "real time", "time", NOTHING),
        ("sim/fan_out.py", '"""', '"""A line. ', NOTHING),
        ("sim/worker_pool.py", '"""', '"""A line. ', NOTHING),
        ("resources/fleet.py", '"""', '"""A line. ', NOTHING),
        ("sim/scenarios/random_noise.yaml", "\n", "\n# A line.\n", NOTHING),
        ("sim/modes.py", '"""', '"""A line. ', NOTHING),
        ("sim/experiments.py", '"""', '"""A line. ', NOTHING),
        ("sim/turtlebot3/drawing.py", '"""', '"""A line. ', NOTHING),
        ("sim/turtlebot3/recipes.py", '"""', '"""A line. ', RUNS),
        ("sim/recording.py", '"""', '"""A line. ', RUNS),
        ("assets/experiment_runs.py", '"""', '"""A line. ', NOTHING),
        ("sim/nav2/amcl.py", '"""', '"""A line. ', RUNS),
        ("sim/atc/fusion.py", '"""', '"""A line. ', RUNS),
        ("sim/fuzzing/operators.py", '"""', '"""A line. ', RUNS),
        ("sim/fuzzing/scenario.schema.json", "{", "{ ", RUNS),
        ("oracle_pipeline/bags/writer.py", '"""', '"""A line. ', RUNS),
        (
            "oracle_pipeline/windows.py",
            "WINDOW_S = 5.0",
            "WINDOW_S = 10.0",
            FEATURES | ANALYSES,
        ),
        (
            "oracle_pipeline/bags/protocol.py",
            "INTERVAL_S = 10",
            "INTERVAL_S = 20",
            RUNS | FEATURES | ANALYSES,
        ),
        ("oracle_pipeline/datasets.py", '"""', '"""A line. ', FEATURES | ANALYSES),
        ("oracle_pipeline/opened_run.py", '"""', '"""A line. ', FEATURES | ANALYSES),
        ("oracle_pipeline/bags/jit.py", '"""', '"""A line. ', RUNS | FEATURES | ANALYSES),
        ("oracle_pipeline/features/scan.py", '"""', '"""A line. ', FEATURES | ANALYSES),
        ("oracle_pipeline/graphs/views.py", '"""', '"""A line. ', FEATURES | ANALYSES),
        ("oracle_pipeline/bags/reader.py", '"""', '"""A line. ', FEATURES | ANALYSES),
        ("oracle_pipeline/bags/manifest.schema.json", "{", "{ ", RUNS | FEATURES | ANALYSES),
        ("oracle_pipeline/evaluation/metrics.py", '"""', '"""A line. ', ANALYSES),
        ("oracle_pipeline/reporting/templates/report.html.j2", "<", " <", ANALYSES),
        ("oracle_pipeline/reporting/html.py", '"""', '"""A line. ', {"reports"}),
        ("assets/oracle_evaluation.py", '"""', '"""A line. ', {"evaluation"}),
        ("oracle_pipeline/cli.py", '"""', '"""A line. ', NOTHING),
        ("oracle_pipeline/replay/command.py", '"""', '"""A line. ', NOTHING),
    ],
)
def test_one_line_changes_the_versions_of_what_depends_on_it(
    tree, before, place, old, new, changed
):
    file = tree / place
    source = file.read_text()
    assert old in source
    file.write_text(source.replace(old, new, 1))
    after = versions(tree)
    file.write_text(source)
    assert {name for name in before if before[name] != after[name]} == changed


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
