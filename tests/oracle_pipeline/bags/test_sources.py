"""The dependencies of a module are read from its imports, without importing anything."""

import ast
import os
import subprocess
import sys

import pytest

from oracle_pipeline.bags.sources import PACKAGES, code_hash, dependencies, imports


@pytest.mark.parametrize(
    ("statement", "imported"),
    [
        ("import a.b, c as d", {"a.b", "c"}),
        ("from a import b as c, d", {"a", "a.b", "a.d"}),
        ("from a.b import (\n    c,  # why\n    d as e,\n)", {"a.b", "a.b.c", "a.b.d"}),
        ("def late():\n    from a import b\n", {"a", "a.b"}),
        ("from . import a", {".", ".a"}),
        ("from ..a import b", {"..a", "..a.b"}),
        ("if TYPE_CHECKING:\n    from a import b\n\n    import c\nimport d", {"d"}),
    ],
)
def test_each_form_of_import_is_understood(statement, imported):
    assert imports(ast.parse(statement)) == imported


@pytest.fixture
def tree(tmp_path):
    for place, text in {
        "sim/__init__.py": "",
        "sim/run.py": "def go():\n    from sim.late import thing\n",
        "sim/late.py": "from sim.deep import below\n",
        "sim/deep/__init__.py": "",
        "sim/deep/below.py": "",
        "sim/deep/table/data.msg": "",
        "sim/deep/__pycache__/below.pyc": "",
        "sim/deep/unused/__init__.py": "",
        "sim/deep/unused/data.json": "",
        "sim/help.py": "import sim.run\n",
    }.items():
        file = tmp_path / place
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path


def test_imports_in_functions_package_files_and_data_count_and_nothing_else(tree):
    files = dependencies(["sim.run"], root=tree)
    assert [file.relative_to(tree).as_posix() for file in files] == [
        "sim/__init__.py",
        "sim/deep/__init__.py",
        "sim/deep/below.py",
        "sim/deep/table/data.msg",
        "sim/late.py",
        "sim/run.py",
    ]


def test_the_hash_depends_on_names_and_contents_and_not_on_the_place(tree):
    before = code_hash(["sim.run"], root=tree)
    moved = tree.with_name("moved")
    tree.rename(moved)
    assert code_hash(["sim.run"], root=moved) == before
    assert code_hash(["sim.run"], "a text", root=moved) != before
    (moved / "sim/deep/table/data.msg").rename(moved / "sim/deep/table/other.msg")
    assert code_hash(["sim.run"], root=moved) != before


def test_files_of_a_folder_count_with_those_below_it(tree, tmp_path):
    folder = tree / "sim/deep/table"
    before = code_hash(["sim.late"], folders=[folder], root=tree)
    assert before != code_hash(["sim.late"], root=tree)
    assert code_hash(["sim.late"], folders=[tree / "none"], root=tree) == code_hash(
        ["sim.late"], root=tree
    )


def test_a_module_that_is_not_there_is_named(tree):
    with pytest.raises(LookupError, match=r"no module sim\.nothing"):
        dependencies(["sim.nothing"], root=tree)


@pytest.mark.slow
def test_the_modules_that_are_loaded_are_among_the_dependencies():
    listing = (
        "import sys, sim.turtlebot3.run\n"
        f"ours = [m for m in sys.modules.values() if m.__name__.split('.')[0] in {PACKAGES}]\n"
        "print(*(m.__file__ for m in ours), sep='\\n')"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", listing], capture_output=True, text=True, check=True
    ).stdout.split()
    assert len(loaded) > 50
    assert set(loaded) <= set(map(str, dependencies(["sim.turtlebot3.run"])))


MODULE = '''
"""What is here."""

import math

LIMIT = 1.5  # [m]


@jit(fastmath=False)
def area(radius, *, times=2):
    """Return an area."""
    if radius > LIMIT:
        return math.nan
    return times * math.pi * radius
'''


@pytest.fixture
def module(tmp_path):
    """Return a function that changes the module and returns its hash."""
    file = tmp_path / "sim/area.py"
    file.parent.mkdir()
    (file.parent / "__init__.py").touch()

    def changed(old="", new=""):
        assert old in MODULE
        file.write_text(MODULE.replace(old, new))
        return code_hash(["sim.area"], root=tmp_path)

    return changed


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# [m]", "# [mm]"),
        ("  # [m]", ""),
        ("# [m]", "# [m]\n\n# Why.\n"),
        ("What is here", "What is there"),
        ('"""What is here."""\n', ""),
        ("Return an area", "Give an area"),
        ('    """Return an area."""\n', ""),
        ("LIMIT = 1.5  # [m]", 'LIMIT = 1.5\n"""The limit [m]."""'),
        ("times * math.pi * radius", "(\n        times * math.pi\n        * radius\n    )"),
        ("(radius, *, times=2)", "(\n    radius,\n    *,\n    times=2,\n)"),
        ("1.5", "1.50"),
    ],
)
def test_comments_docstrings_and_layout_change_no_hash(module, old, new):
    assert module(old, new) == module()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("1.5", "1.6"),
        ("times=2", "times=3"),
        ("times=2", "times=2.0"),
        ("*, ", ""),
        ("fastmath=False", "fastmath=True"),
        ("fastmath=False", ""),
        ("@jit", "@njit"),
        ("@jit(fastmath=False)\n", ""),
        ("math.nan", "None"),
        ("> LIMIT", ">= LIMIT"),
        ("LIMIT", "MOST"),
    ],
)
def test_what_a_module_means_changes_its_hash(module, old, new):
    assert module(old, new) != module()


def test_the_users_plugins_count_by_their_meaning_and_broken_ones_by_their_bytes(tree, tmp_path):
    plugin = tmp_path / "plugins/mine.py"
    plugin.parent.mkdir()

    def of(text):
        plugin.write_text(text)
        return code_hash(["sim.late"], folders=[plugin.parent], root=tree)

    assert of("LIMIT = 1\n") == of("LIMIT = 1  # [m]\n") != of("LIMIT = 2\n")
    assert of("LIMIT = \n") != of("LIMIT = # [m]\n")


def in_a_new_process(code, cache):
    return subprocess.run(
        [sys.executable, "-c", f"from oracle_pipeline.bags import sources\n{code}"],
        env={**os.environ, "XDG_CACHE_HOME": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


HASH = "print(sources.code_hash(['sim.atc.run']))"


def test_a_process_reads_no_module_that_another_has_read(tmp_path):
    first = in_a_new_process(HASH, tmp_path)
    assert in_a_new_process(f"sources.ast.parse = None\n{HASH}", tmp_path) == first
    assert first == f"{code_hash(['sim.atc.run'])}\n"


def test_no_cache_folder_and_a_damaged_cache_cost_time_only(tmp_path):
    (tmp_path / "file").touch()
    assert in_a_new_process(HASH, tmp_path / "file") == in_a_new_process(HASH, tmp_path)
    (kept,) = (tmp_path / "ros2-behaviour-oracle").iterdir()
    kept.write_text(kept.read_text()[:1000])
    assert in_a_new_process(HASH, tmp_path) == in_a_new_process(HASH, tmp_path / "file")
