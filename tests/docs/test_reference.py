"""The reference pages are true."""

import json
import os
import re
import runpy
import subprocess

import pytest

from assets.partitions import run_count, runs_per_partition
from oracle_pipeline.definitions import defs
from oracle_pipeline.features import build_manager
from sim.campaigns import Campaign
from sim.commands.parameter_values import BUILT_IN as MAGNITUDES
from sim.modes import modes
from sim.testbeds import BUILT_IN, TESTBEDS, which_testbed
from tests.docs.pages import DOCS, REPOSITORY
from tools.bench.magnitudes import ROBOTS

SCHEMA = REPOSITORY / "oracle_pipeline" / "bags" / "manifest.schema.json"
SOURCES = ("oracle_pipeline", "assets", "resources", "sim", "deploy", "tests")


@pytest.fixture
def built():
    """A function that builds a page of the reference, as the site shows it."""
    hook = runpy.run_path(str(DOCS / "hooks" / "tables.py"))["on_page_markdown"]
    return lambda name, folder="reference": hook((DOCS / folder / name).read_text("utf-8"))


def test_the_built_page_has_a_row_for_every_built_in_feature(built, monkeypatch):
    monkeypatch.delenv("ORACLE_PLUGINS", raising=False)
    rows = re.findall(r"^\| `([\w.]+)` \|(?: [^|]+ \|){5}$", built("features.md"), re.M)
    assert rows == list(build_manager().features())


def test_the_built_page_has_a_row_for_every_field_of_a_manifest(built):
    rows = re.findall(r"^\| `([\w.]+)` \|", built("manifest.md"), re.M)
    schema = json.loads(SCHEMA.read_text("utf-8"))
    objects = [schema, *schema["$defs"].values()]
    fields = {name for each in objects for name in each.get("properties", {})}
    assert fields <= set(rows)
    assert {"drive.clearance_m", "drive.commands"} <= set(rows)  # nested ones have their path


def test_the_built_page_has_a_row_for_every_mode(built, monkeypatch):
    monkeypatch.delenv("ORACLE_SCENARIOS", raising=False)
    rows = re.findall(r"^\| (?:\w+ \| )?`(\w+)` \|", built("modes.md"), re.M)
    alone = [name for name in modes() if which_testbed(modes()[name].scenario) in BUILT_IN]
    assert set(rows) >= {name for name in alone if not name.endswith("_shadow")}


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_built_page_has_a_row_for_every_fault_that_has_a_magnitude(built, robot):
    rows = re.findall(r"^\| `(\w+)` \| \w+, .* to ", built(f"{robot}.md", "explanation"), re.M)
    assert rows == [mode for mode in TESTBEDS[robot].experiments if MAGNITUDES.get(mode)]


def test_the_configuration_page_lists_every_variable_and_no_other():
    found = subprocess.run(
        ["git", "grep", "-hoE", r"\bORACLE_[A-Z0-9_]+\b", "--", *SOURCES, "Makefile"],
        cwd=REPOSITORY, capture_output=True, text=True, check=True,
    )  # fmt: skip
    page = (DOCS / "reference" / "configuration.md").read_text("utf-8")
    assert set(re.findall(r"`(ORACLE_\w+)`", page)) == set(found.stdout.split())


@pytest.mark.parametrize(
    "variable",
    [
        *("ORACLE_RUNS", "ORACLE_RUNS_PER_PARTITION", "ORACLE_GOALS_PER_RUN"),
        *("ORACLE_ARENA", "ORACLE_NAV2"),
    ],
)
def test_defaults_on_the_configuration_page_are_those_of_the_code(variable, monkeypatch):
    monkeypatch.delenv(variable, raising=False)
    actual = {
        "ORACLE_RUNS": lambda: run_count(os.environ),
        "ORACLE_RUNS_PER_PARTITION": lambda: runs_per_partition(os.environ),
        "ORACLE_ARENA": lambda: Campaign.from_environment().options.arena,
        "ORACLE_NAV2": lambda: Campaign.from_environment().options.nav2,
        "ORACLE_GOALS_PER_RUN": lambda: Campaign.from_environment().goals_per_run,
    }[variable]()
    page = (DOCS / "reference" / "configuration.md").read_text("utf-8")
    assert f"| `{variable}` | {actual} |" in page


def test_the_configuration_page_names_every_asset_and_job_setting():
    page = (DOCS / "reference" / "configuration.md").read_text("utf-8")
    fields = set()
    for node in defs.resolve_implicit_global_asset_job_def().graph.nodes:
        schema = node.definition.config_schema.config_type
        fields |= set(getattr(schema, "fields", {}))
    assert fields
    assert {field for field in fields if f"| `{field}` |" not in page} == set()
