"""Our packages are found where others have their names, or an error message explains the clash."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

PROGRAM = (
    "import sys; from oracle_pipeline.programs import {0}; sys.argv = ['{0}', '--help']; {0}()"
)
NAMES = ("assets", "resources", "sim")


def python(text, hidden):
    """Run code in a folder whose packages have precedence."""
    return subprocess.run(
        [sys.executable, "-c", text], cwd=hidden, env=os.environ | {"PYTHONPATH": str(hidden)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture
def users(tmp_path):
    """A folder with packages of our names."""
    for name in NAMES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    return tmp_path


@pytest.mark.parametrize(
    "text",
    [
        PROGRAM.format("oracle_sim"),
        PROGRAM.format("oracle_ui"),
        "import oracle_pipeline.definitions, assets; assert assets.__doc__",
    ],
)
def test_programs_and_code_location_find_our_packages_beside_others(text, users):
    done = python(text, users)
    assert done.returncode == 0, done.stderr


def test_workers_find_our_packages_beside_others(users):
    done = python(
        "import oracle_pipeline.programs\n"
        "from sim.campaigns import Campaign\n"
        "from sim.experiments import recipe_for\n"
        "from sim.fan_out import fan_out, process_pool\n"
        "from functools import partial\n"
        "draw = partial(recipe_for, campaign=Campaign(), run=0)\n"
        "if __name__ == '__main__':\n"
        "    for each in fan_out(draw, ['fake_object'], lambda: process_pool(1)):\n"
        "        assert each.error is None, each.error\n"
        "        print(each.result.mode)\n",
        users,
    )
    assert done.stdout == "fake_object\n", done.stderr


def test_a_package_of_the_same_name_that_was_imported_before_is_reported(users):
    done = python("import resources, oracle_pipeline.definitions", users)
    assert done.returncode == 1
    error = done.stderr.strip().splitlines()[-1]
    assert f"the package 'resources' of ros2-behaviour-oracle in {users / 'resources'}" in error
    assert "separate virtual environment" in error


def test_an_import_that_fails_for_another_reason_is_left_as_it_is(tmp_path):
    (tmp_path / "dagster.py").touch()
    done = python("import oracle_pipeline.definitions", tmp_path)
    assert "separate virtual environment" not in done.stderr
    assert done.returncode == 1


def test_importing_the_package_imports_no_library_until_a_name_is_used():
    code = (
        "import sys, oracle_pipeline\n"
        "assert not {'numpy', 'pandas', 'oracle_pipeline.features'} & sys.modules.keys()\n"
        "assert oracle_pipeline.features.compute\n"
        "assert not hasattr(oracle_pipeline, 'no_such_name')\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
