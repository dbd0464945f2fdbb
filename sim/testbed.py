"""The interface of a testbed and of its experiments: what a plug-in has to supply.

``sim.testbeds`` finds all testbeds. `sim.testbed_run` and `sim.timed_run` have what runs share.
"""

import json
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Self, get_args, get_origin

import numpy as np

from oracle_pipeline.bags.manifest import Label
from sim.campaigns import Campaign, Storage
from sim.fuzzing.random import drawn_values
from sim.fuzzing.scenario import Scenario
from sim.seeds import NODE, attack_seed, node_generator

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun

SCENARIOS = Path(__file__).with_name("scenarios")  # folder of the built-in ones


@dataclass(frozen=True, slots=True)
class Mode:
    """One experiment."""

    scenario: Scenario
    conditions: Mapping[str, Any] = field(default_factory=dict)  # changes of its testbed

    @property
    def id(self) -> str:
        """Name of the mode: the scenario's."""
        return self.scenario.id

    @property
    def label(self) -> Label:
        """Label of its runs."""
        return self.scenario.label

    def noise(self, campaign: Campaign) -> str:
        """Return the branch from which its runs draw sensor noise and latencies.

        Empty for that of the block. If the campaign draws noise for each run, it is that of the
        mode, which an attack shares with its shadow control, so such pairs stay exact.
        """
        if not campaign.noise_per_run:
            return ""
        return self.id.removesuffix("_shadow") if self.scenario.control == "shadow" else self.id

    def parameters(
        self, block: Mapping[str, Any], given: Mapping[str, Any], run_seed: int
    ) -> dict[str, Any]:
        """Return a value for every parameter.

        In this order: the given value, the block's, one drawn for the run, the default.

        Parameters
        ----------
        block
            Values drawn for the block.
        given
            Values by name of parameter; they are checked when the scenario is executed.
        run_seed
            Seed of the scenario's own draws.

        Raises
        ------
        ScenarioError
            If a parameter needs a value that a block of this testbed does not have.
        """
        defaults = {
            name: spec["default"]
            for name, spec in self.scenario.document.get("parameters", {}).items()
        }
        for name, what in self.scenario.drawn.items():
            if what not in block:
                raise self.scenario.error(
                    ("parameters", name, "drawn"),
                    f"expected a value that blocks have ({', '.join(block)}), found {what}",
                )
        of_block = {name: block[what] for name, what in self.scenario.drawn.items()}
        return {**defaults, **drawn_values(self.scenario, run_seed), **of_block, **given}

    def recipe_fields(
        self, block: int, campaign: Campaign, drawn: Mapping[str, Any], given: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return the fields that the recipes of all testbeds have, for a run of this mode.

        Parameters
        ----------
        block, campaign
            Number of the block, which is that of the run, and the campaign.
        drawn, given
            What the block has drawn, and given values, for the scenario's parameters.
        """
        return {
            "mode": self.id,
            "scenario": self.scenario.document,
            "parameters": self.parameters(drawn, given, attack_seed(campaign.seed, block)),
            "run": block,
            "block": block,
            "seed": campaign.seed,
            "storage": campaign.storage,
            "noise": self.noise(campaign),
        }


@dataclass(frozen=True, slots=True)
class Recipe:
    """Everything that determines a run: numbers, texts and frozen dataclasses of these."""

    mode: str
    scenario: Mapping[str, Any]  # the document
    parameters: Mapping[str, Any]  # a value for each of the scenario's
    run: int
    block: int
    seed: int
    storage: Storage
    noise: str  # `Mode.noise`

    def generator(self, node: str) -> np.random.Generator:
        """Return the generator of one node; equal in all runs of a block that share their noise."""
        return node_generator(self.seed, NODE, self.block, self.noise + node)

    def attack_seed(self) -> int:
        """Return the key of the attack's own, counter-based randomness."""
        return attack_seed(self.seed, self.block)

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(self.seed, storage=self.storage, noise_per_run=bool(self.noise))

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON values."""
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return document

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe from the result of ``to_dict``; tuples and dataclasses come back."""
        recipe: Self = from_json(cls, document)
        return recipe


def later(place: str) -> Callable[..., Any]:
    """Return a function that imports ``module:name`` only when it is called, as that takes long."""
    return lambda *arguments: pkgutil.resolve_name(place)(*arguments)


def from_json(kind: Any, value: Any) -> Any:
    """Return a value from JSON as one of a type; of several dataclasses, that with its fields."""
    if isinstance(kind, UnionType) and isinstance(value, Mapping):
        of_fields = {
            frozenset(item.name for item in fields(each)): each
            for each in get_args(kind)
            if is_dataclass(each)
        }
        kind = of_fields[frozenset(value)]
    if isinstance(kind, type) and is_dataclass(kind):
        types = {item.name: item.type for item in fields(kind)}
        return kind(**{name: from_json(types.get(name), part) for name, part in value.items()})
    if get_origin(kind) is tuple:
        return tuple(from_json(get_args(kind)[0], part) for part in value)
    return value


@dataclass(frozen=True, slots=True, kw_only=True)
class Testbed:
    """A testbed: how its runs are drawn and executed.

    Parameters
    ----------
    scenarios
        Folder of its scenario files; by default that of the built-in ones.
    experiments
        Scenarios of that folder that are modes, a normal one first, in the order in which they are
        shown. The shadow controls of the attacks among them follow.
    hard_negatives
        Scenarios of that folder that are normal but look unusual, with the changed conditions.
    messages
        Packages whose messages only this testbed has. A scenario that names no testbed and reads
        one of them runs here.
    recipe
        Class of the recipes.
    draw
        Draws the recipe of a mode's run of a campaign, given values for parameters.
    bring_up
        Starts the system for one run, which is written into an existing and empty folder.
    made_by
        The module with the class of runs. It and its imports are the software of a run.
    libraries
        Distributions, besides those of this project, that the messages of a run depend on.
    deterministic
        Whether the same recipe and software give the same messages. If not, a dropped bag could not
        be simulated again, so none is dropped.
    """

    scenarios: Path = SCENARIOS
    experiments: tuple[str, ...]
    hard_negatives: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    messages: frozenset[str] = frozenset()
    recipe: type[Recipe]
    draw: Callable[[Mode, int, Campaign, Mapping[str, Any]], Recipe]
    bring_up: Callable[[Any, Path], "TestbedRun"]
    made_by: str
    libraries: tuple[str, ...] = ()
    deterministic: bool = True
