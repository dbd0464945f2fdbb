"""The error message explains if another package has the name of one of ours."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

PROGRAM = (
    "import sys; from oracle_pipeline.programs import {0}; sys.argv = ['{0}', '--help']; {0}()"
)


def python(text, hidden):
    """Run code in a folder whose packages have precedence."""
    return subprocess.run(
        [sys.executable, "-c", text], cwd=hidden, env=os.environ | {"PYTHONPATH": str(hidden)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("resources", PROGRAM.format("oracle_sim")),
        ("sim", PROGRAM.format("oracle_sim")),
        ("resources", PROGRAM.format("oracle_ui")),
        ("assets", "import oracle_pipeline.definitions"),
        ("resources", "import oracle_pipeline.definitions"),
    ],
)
def test_a_clash_of_names_is_reported_with_paths_and_remedy(name, text, tmp_path):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").touch()
    done = python(text, tmp_path)
    assert done.returncode == 1
    error = done.stderr.strip().splitlines()[-1]
    assert f"the package {name!r} of ros2-behaviour-oracle in {tmp_path / name} instead of" in error
    assert "separate virtual environment" in error


def test_a_module_in_place_of_a_package_is_reported_too(tmp_path):
    (tmp_path / "sim.py").touch()
    done = python(PROGRAM.format("oracle_sim"), tmp_path)
    assert done.returncode == 1
    assert f"in {tmp_path / 'sim.py'} instead of" in done.stderr
    assert "Traceback" not in done.stderr


def test_an_import_that_fails_for_another_reason_is_left_as_it_is(tmp_path):
    (tmp_path / "dagster.py").touch()
    done = python("import oracle_pipeline.definitions", tmp_path)
    assert "separate virtual environment" not in done.stderr
    assert done.returncode == 1


def test_the_programs_work_where_nothing_clashes(tmp_path):
    for name in ("oracle_sim", "oracle_ui"):
        assert python(PROGRAM.format(name), tmp_path).returncode == 0


def test_importing_the_package_imports_no_library_until_a_name_is_used():
    code = (
        "import sys, oracle_pipeline\n"
        "assert not {'numpy', 'pandas', 'oracle_pipeline.features'} & sys.modules.keys()\n"
        "assert oracle_pipeline.features.compute\n"
        "assert not hasattr(oracle_pipeline, 'no_such_name')\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
