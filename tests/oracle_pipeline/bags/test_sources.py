"""The dependencies of a module are read from its imports, without importing anything."""

import ast
import subprocess
import sys

import pytest

from oracle_pipeline.bags.sources import PACKAGES, ROOT, code_hash, dependencies, imports

MODULES = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]


def is_types_only(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def parsed_imports(node):
    """Return what the parser finds, in modules that import by absolute names."""
    names = set()
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            names |= {alias.name for alias in child.names}
        elif isinstance(child, ast.ImportFrom):
            names |= {child.module, *(f"{child.module}.{alias.name}" for alias in child.names)}
        elif not is_types_only(child):
            names |= parsed_imports(child)
    return names


def ours(names):
    return {name for name in names if name.split(".")[0] in PACKAGES}


def test_the_text_of_every_module_of_ours_is_read_as_the_parser_reads_it():
    assert len(MODULES) > 150
    for file in MODULES:
        source = file.read_text()
        assert ours(imports(source, "")) == ours(parsed_imports(ast.parse(source))), file


@pytest.mark.parametrize(
    ("statement", "imported"),
    [
        ("import a.b, c as d", {"a.b", "c"}),
        ("from a import b as c, d", {"a", "a.b", "a.d"}),
        ("from a.b import (\n    c,  # why\n    d as e,\n)", {"a.b", "a.b.c", "a.b.d"}),
        ("def late():\n    from a import b\n", {"a", "a.b"}),
        ("from . import a", {"p.q", "p.q.a"}),
        ("from ..a import b", {"p.a", "p.a.b"}),
        ("if TYPE_CHECKING:\n    from a import b\n\n    import c\nimport d", {"d"}),
    ],
)
def test_each_form_of_import_is_understood(statement, imported):
    assert imports(statement, "p.q") == imported


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


def test_all_of_the_simulation_is_hashed_in_a_tenth_of_a_second():
    hashing = (
        "import time; from oracle_pipeline.bags.sources import code_hash\n"
        "started = time.process_time(); code_hash(['sim.turtlebot3.run'])\n"
        "print(time.process_time() - started)"
    )

    def took_s():  # in a new process, which has read nothing yet
        done = subprocess.run(
            [sys.executable, "-c", hashing], capture_output=True, text=True, check=True
        )
        return float(done.stdout)

    assert min(took_s() for _ in range(3)) < 0.1
