"""A testbed from a file: commands that start a system, and say when its run has begun and ended.

Nothing in the file is code. Commands are lists of arguments, which no shell reads; ``{name}`` in
them is a value that the block has drawn, or ``domain``, ``run``, ``block`` or ``mode``.
"""

import functools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.campaigns import Campaign
from sim.fuzzing.scenario import ScenarioError, load_document
from sim.seeds import BLOCK, generator
from sim.testbed import Mode, Recipe, Testbed

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun

FOLDER = "ORACLE_TESTBEDS"  # environment variable: the user's folder of these files
KNOWN = ("domain", "run", "block", "mode")  # that every command may name

_NAMED = re.compile(r"\{([a-z][a-z0-9_]*)\}")
_DECIMALS = 4  # of values that are drawn, so that commands stay readable


@dataclass(frozen=True, slots=True)
class OutsideRecipe(Recipe):
    """Everything that determines a run, but for the system itself."""

    session: int
    system: Mapping[str, Any]  # the content of the file
    values: Mapping[str, float | str]  # that the block has drawn


def read_testbed(file: Path) -> Testbed:
    """Return the testbed of a file.

    Raises
    ------
    ScenarioError
        If the file is invalid.
    """
    rules = json.loads(Path(__file__).with_name("testbed.schema.json").read_text("utf-8"))
    system = load_document(file, rules)
    known = {*KNOWN, *system.get("vary", {})}
    if unknown := [name for name in _NAMED.findall(json.dumps(system)) if name not in known]:
        raise ScenarioError(
            f"{file}: expected one of {', '.join(sorted(known))} in braces, found {unknown[0]}."
        )
    return Testbed(
        scenarios=file.parent / system["scenarios"], experiments=tuple(system["experiments"]),
        recipe=OutsideRecipe, draw=functools.partial(_draw, system),
        bring_up=functools.partial(_bring_up, file.parent), made_by="sim.outside.run",
        deterministic=False,
    )  # fmt: skip


def filled(value: Any, values: Mapping[str, Any]) -> Any:
    """Return a part of a document with the values in place of their names."""
    match value:
        case str():
            return _NAMED.sub(lambda name: str(values[name[1]]), value)
        case list():
            return [filled(each, values) for each in value]
        case dict():
            return {key: filled(each, values) for key, each in value.items()}
    return value


def _draw(
    system: Mapping[str, Any],
    mode: Mode,
    run: int,
    campaign: Campaign,
    parameters: Mapping[str, Any],
) -> OutsideRecipe:
    rng = generator(campaign.seed, BLOCK, run)
    values = {name: _drawn(spec, rng) for name, spec in system.get("vary", {}).items()}
    return OutsideRecipe(
        **mode.recipe_fields(run, campaign, values, parameters),
        session=campaign.session_of(run),
        system=system,
        values=values,
    )


def _drawn(spec: Mapping[str, Any], rng: np.random.Generator) -> float | str:
    if "of" in spec:
        chosen: float | str = spec["of"][int(rng.integers(len(spec["of"])))]
        return chosen
    return round(float(rng.uniform(spec["min"], spec["max"])), _DECIMALS)


def _bring_up(at: Path, recipe: OutsideRecipe, folder: Path) -> "TestbedRun":
    from sim.outside.run import OutsideRun  # DDS takes long to import, and is optional

    return OutsideRun(recipe, folder, at)
