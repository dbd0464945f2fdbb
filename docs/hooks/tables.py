"""An MkDocs hook that puts tables of what the code has into the pages.

A line ``<!-- table: features -->`` becomes the table of all built-in features. ``manifest`` names
those of the fields of a manifest, ``found_attacks`` that of the attacks that searches found,
``other_modes`` that of the modes of all built-in testbeds but the first, ``program_mutants`` the
kill matrix of mutants of the program, and ``magnitudes_arm`` how many runs of an arm are called,
for each size of each fault.
"""

import json
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from oracle_pipeline import features
from oracle_pipeline.bags import run_directory
from sim.scenarios import builtin_scenarios
from sim.testbeds import BUILT_IN, TESTBEDS
from tools.bench.kill_table import kill_table, named

MARK = re.compile(r"^<!-- table: (\w+) -->$", re.M)
FOUND = Path(__file__).parents[2] / "examples" / "found_attacks"
EXPLANATION = Path(__file__).parents[1] / "explanation"
SCHEMA = Path(run_directory.__file__).with_name("manifest.schema.json")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace each mark by its table."""
    return MARK.sub(lambda mark: "\n".join(TABLES[mark[1]]()), markdown)


def feature_table() -> Iterator[str]:
    """Yield a row for each built-in feature."""
    yield "| column | unit | floor | origin | windows | what it is |"
    yield "| --- " * 6 + "|"
    for column, feature in features.build_manager().features().items():
        windows = "yes" if feature.per_window else "no"
        marks = {"shortcut": feature.shortcut, "behaviour": feature.behaviour}
        origin = ", ".join([feature.origin, *(mark for mark, given in marks.items() if given)])
        yield (
            f"| `{column}` | {feature.unit} | {feature.floor:g} | {origin} | {windows} "
            f"| {feature.description} |"
        )


def manifest_tables() -> Iterator[str]:
    """Yield the fields of a manifest, then those of each kind of object in it."""
    schema = json.loads(SCHEMA.read_text("utf-8"))
    yield from ("| field | value | meaning |", "| --- | --- | --- |", *rows(schema["properties"]))
    for name, definition in schema["$defs"].items():
        if "properties" in definition:
            yield from ("", f"A {name.replace('_', ' ')}:", "")
            yield from ("| field | value | meaning |", "| --- | --- | --- |")
            yield from rows(definition["properties"])


def found_attacks() -> Iterator[str]:
    """Yield a row for each attack that a search found, from the comments in its file."""
    yield "| attack | when it was found | now |"
    yield "| --- | --- | --- |"
    for file in sorted(FOUND.rglob("*.yaml")):
        comments = [line[2:] for line in file.read_text("utf-8").splitlines() if line[:2] == "# "]
        if comments:
            now = comments[-1].rstrip(".") if file.parent != FOUND else "missed"
            yield f"| `{file.stem}` | {comments[0].rstrip('.')} | {now} |"


def other_modes() -> Iterator[str]:
    """Yield a row for each mode of the testbeds after the first, without shadow controls."""
    yield "| testbed | mode | label | what happens |"
    yield "| --- | --- | --- | --- |"
    for testbed in list(BUILT_IN)[1:]:
        known = TESTBEDS[testbed]
        for mode in (*known.experiments, *known.hard_negatives):
            scenario = builtin_scenarios()[mode]
            yield f"| {testbed} | `{mode}` | {scenario.label} | {scenario.title} |"


def program_mutants() -> Iterator[str]:
    """Yield the kill matrix of mutants of the program, and a paragraph on each group of them."""
    runs = pd.read_csv(EXPLANATION / "program_mutants.csv")
    yield from kill_table(runs)
    for line in named(runs):
        yield from ("", line)


def magnitudes(testbed: str) -> Iterator[str]:
    """Yield a row for each fault of a testbed: how many runs are called at each value."""
    called = pd.read_csv(EXPLANATION / "magnitudes.csv")
    called = called[(called["testbed"] == testbed) & called["parameter"].notna()]
    runs = called["runs"].iloc[0]
    yield f"| mode | value | called of {runs}, from the smallest value to the largest |"
    yield "| --- | --- | --- |"
    for mode, of_mode in called.groupby("mode", sort=False):
        first, last = of_mode.iloc[0], of_mode.iloc[-1]
        unit = f" {first['unit']}" if isinstance(first["unit"], str) else ""
        ends = f"{first['parameter']}, {first['value']:g} to {last['value']:g}{unit}"
        yield f"| `{mode}` | {ends} | {', '.join(map(str, of_mode['called']))} |"


def rows(fields: dict[str, Any], before: str = "") -> Iterator[str]:
    """Yield a row for each field, those of nested objects after their own."""
    for name, field in fields.items():
        yield f"| `{before}{name}` | {kind(field)} | {field.get('description', '')} |"
        yield from rows(field.get("properties", {}), f"{before}{name}.")


def kind(field: dict[str, Any]) -> str:
    """Describe the allowed values of a field."""
    if "$ref" in field:
        return str(field["$ref"].rpartition("/")[2])
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    if "const" in field:
        return f"`{field['const']}`"
    if "items" in field:
        return f"list of {kind(field['items'])}"
    return " or ".join(field["type"] if isinstance(field["type"], list) else [field["type"]])


TABLES: dict[str, Callable[[], Iterator[str]]] = {
    "features": feature_table,
    "manifest": manifest_tables,
    "found_attacks": found_attacks,
    "other_modes": other_modes,
    "program_mutants": program_mutants,
    "magnitudes_arm": partial(magnitudes, "arm"),
    "magnitudes_crazyflie": partial(magnitudes, "crazyflie"),
}
