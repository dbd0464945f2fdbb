"""Imports go one way only: definitions, assets, resources, sim, oracle_pipeline.bags."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = ("oracle_pipeline", "assets", "sim", "resources")
ROOF = "oracle_pipeline.definitions"

# Longest matching prefix of the importing module -> prefixes of ours that it may import.
MAY_IMPORT = {
    ROOF: {"assets", "resources", "sim", "oracle_pipeline"},
    "assets": {"assets", "resources", "sim", "oracle_pipeline"},
    "assets.worker": {"assets.worker", "resources.storage", "sim", "oracle_pipeline"},
    "resources": {"resources", "sim", "oracle_pipeline"},
    "resources.storage": {"resources.storage", "sim", "oracle_pipeline"},
    "sim": {"sim", "oracle_pipeline.bags"},
    "oracle_pipeline": {"oracle_pipeline"},
    "oracle_pipeline.bags": {"oracle_pipeline.bags"},
}
# The same for libraries of others that only some of our parts may know.
MAY_NOT_IMPORT = {
    ROOF: set(),
    "assets": {"mujoco", "rosbags"},
    "assets.worker": {"dagster", "mujoco", "rosbags"},
    "resources": {"mujoco", "rosbags"},
    "resources.storage": {"dagster", "mujoco", "rosbags"},
    "sim": {"dagster", "pandas", "sklearn"},
    "oracle_pipeline": {"dagster", "mujoco"},
    "oracle_pipeline.bags": {"dagster", "mujoco", "pandas", "sklearn"},
}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(source: str, module: str, *, is_package: bool = False) -> set[str]:
    """Return the dotted names that a module imports, wherever in it the statement stands."""
    package = module.split(".") if is_package else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*above, *([node.module] if node.module else [])])
            # A name is a module of its own or an attribute; both are covered by origin.name.
            found |= {f"{origin}.{alias.name}" for alias in node.names}
    return found


def within(name: str, prefixes: set[str]) -> bool:
    return any(name == prefix or name.startswith(f"{prefix}.") for prefix in prefixes)


def part_of(module: str) -> str:
    return max((part for part in MAY_IMPORT if within(module, {part})), key=len)


def violations(module: str, imported: set[str]) -> list[str]:
    part = part_of(module)
    ours = {name for name in imported if within(name, set(OURS))}
    wrong = {name for name in ours if not within(name, MAY_IMPORT[part])}
    wrong |= {name for name in ours if within(name, {ROOF})}
    wrong |= {name for name in imported if within(name, MAY_NOT_IMPORT[part])}
    return sorted(wrong)


MODULES = {
    module_name(path): imports(
        path.read_text(encoding="utf-8"), module_name(path), is_package=path.stem == "__init__"
    )
    for package in OURS
    for path in sorted((ROOT / package).rglob("*.py"))
}


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_only_what_is_below_it(module):
    assert violations(module, MODULES[module]) == []


def test_only_one_module_uses_private_names_of_dagster():
    private = {
        str(path.relative_to(ROOT))
        for folder in (*OURS, "bench", "soak", "tests")
        for path in (ROOT / folder).rglob("*.py")
        if any(
            name.startswith("dagster._")
            for name in imports(path.read_text(encoding="utf-8"), module_name(path))
        )
    }
    assert private == {"assets/dagster_internals.py", "tests/assets/dagster_internals.py"}


@pytest.mark.parametrize("folder", ["assets.worker", "resources.storage"])
def test_workers_and_the_storage_plan_start_without_dagster(folder):
    modules = ", ".join(module for module in MODULES if within(module, {folder}))
    code = f"import sys, {modules}; sys.exit('dagster' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("sim.recording", "import oracle_pipeline.graphs"),
        ("sim.recording", "from oracle_pipeline import graphs"),
        ("sim.recording", "def late():\n    from oracle_pipeline.features import manager"),
        ("sim.nav2.amcl", "import dagster as dg"),
        ("oracle_pipeline.graphs", "from sim.modes import PAIRS"),
        ("oracle_pipeline.graphs", "import mujoco"),
        ("oracle_pipeline.bags.reader", "from oracle_pipeline import datasets"),
        ("oracle_pipeline.bags.reader", "from .. import datasets"),
        ("oracle_pipeline.cli", "from .definitions import defs"),
        ("resources.store", "from assets.partitions import RUNS"),
        ("assets.runs", "from oracle_pipeline.definitions import defs"),
        ("assets.worker.run", "import dagster"),
        ("assets.worker.run", "from assets.partitions import RUNS"),
        ("resources.storage.plan", "from resources.fleet import Fleet"),
    ],
)
def test_the_rule_notices_what_it_forbids(module, source):
    assert violations(module, imports(source, module))
