"""Keeps the reference pages true; run as a script, it writes the manifest's table again."""

import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from assets.partitions import run_count
from oracle_pipeline.definitions import defs
from sim.campaigns import Campaign
from tests.docs.pages import DOCS, REPOSITORY

SCHEMA = REPOSITORY / "oracle_pipeline" / "bags" / "manifest.schema.json"
MANIFEST = DOCS / "reference" / "manifest.md"
BEGIN, END = "<!-- manifest: begin -->\n", "<!-- manifest: end -->\n"
SOURCES = ("oracle_pipeline", "assets", "resources", "sim", "deploy", "tests")


def kind(field: dict) -> str:
    """Describe the allowed values."""
    if "$ref" in field:
        return field["$ref"].rpartition("/")[2]
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    if "const" in field:
        return f"`{field['const']}`"
    types = field["type"] if isinstance(field["type"], list) else [field["type"]]
    if "items" in field:
        return f"list of {kind(field['items'])}"
    return " or ".join(types)


def rows(fields: dict, before: str = "") -> list[str]:
    lines = []
    for name, field in fields.items():
        about = field.get("description", "")
        if "properties" in field:
            lines.append(f"| `{before}{name}` | {kind(field)} | {about} |")
            lines += rows(field["properties"], f"{before}{name}.")
        else:
            lines.append(f"| `{before}{name}` | {kind(field)} | {about} |")
    return lines


def table() -> str:
    schema = json.loads(SCHEMA.read_text("utf-8"))
    lines = ["| field | value | meaning |", "| --- | --- | --- |", *rows(schema["properties"])]
    for name, definition in schema["$defs"].items():
        if "properties" in definition:
            lines += ["", f"A {name.replace('_', ' ')}:", "", "| field | value | meaning |",
                      "| --- | --- | --- |", *rows(definition["properties"])]  # fmt: skip
    return "\n".join(lines) + "\n"


def test_the_manifest_page_follows_the_schema():
    written = MANIFEST.read_text("utf-8").partition(BEGIN)[2].partition(END)[0]
    assert written == table(), f"run {Path(__file__).name} as a script"


def test_the_configuration_page_lists_every_variable_and_no_other():
    found = subprocess.run(
        ["git", "grep", "-hoE", r"\bORACLE_[A-Z0-9_]+\b", "--", *SOURCES, "Makefile"],
        cwd=REPOSITORY, capture_output=True, text=True, check=True,
    )  # fmt: skip
    page = (DOCS / "reference" / "configuration.md").read_text("utf-8")
    assert set(re.findall(r"`(ORACLE_\w+)`", page)) == set(found.stdout.split())


@pytest.mark.parametrize(
    "variable", ["ORACLE_RUNS", "ORACLE_GOALS_PER_RUN", "ORACLE_ARENA", "ORACLE_NAV2"]
)
def test_defaults_on_the_configuration_page_are_those_of_the_code(variable, monkeypatch):
    monkeypatch.delenv(variable, raising=False)
    actual = {
        "ORACLE_RUNS": lambda: run_count(os.environ),
        "ORACLE_ARENA": lambda: Campaign.from_environment().options.arena,
        "ORACLE_NAV2": lambda: Campaign.from_environment().options.nav2,
        "ORACLE_GOALS_PER_RUN": lambda: Campaign.from_environment().goals_per_run,
    }[variable]()
    page = (DOCS / "reference" / "configuration.md").read_text("utf-8")
    assert f"| `{variable}` | {actual} |" in page


def test_the_configuration_page_names_every_asset_and_job_setting():
    page = (DOCS / "reference" / "configuration.md").read_text("utf-8")
    fields = set()
    for job in (
        defs.resolve_implicit_global_asset_job_def(),
        defs.resolve_job_def("forget_old_runs"),
    ):
        for node in job.graph.nodes:
            schema = node.definition.config_schema.config_type
            fields |= set(getattr(schema, "fields", {}))
    assert fields
    assert {field for field in fields if f"| `{field}` |" not in page} == set()


if __name__ == "__main__":
    before, _, rest = MANIFEST.read_text("utf-8").partition(BEGIN)
    MANIFEST.write_text(before + BEGIN + table() + END + rest.partition(END)[2], "utf-8")
