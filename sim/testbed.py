"""The interface of a testbed and of its experiments.

Each testbed has a folder with a module ``testbed``; ``sim.testbeds`` lists them all.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from oracle_pipeline.bags.manifest import Label, Manifest, Software
from sim.campaigns import Campaign
from sim.fuzzing.drawn_parameters import drawn_values
from sim.fuzzing.node import ScenarioNode
from sim.fuzzing.scenario import Scenario
from sim.middleware.domain import Domain


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

    @property
    def title(self) -> str:
        """Its purpose, in one line."""
        return self.scenario.title

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


class Recipe(Protocol):
    """Everything that determines a run; a frozen dataclass of numbers, texts and other recipes."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def mode(self) -> str:
        """Name of the mode."""

    @property
    def scenario(self) -> Mapping[str, Any]:
        """The scenario's document."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """A value for each parameter of the scenario."""

    def generator(self, node: str) -> np.random.Generator:
        """Return the randomness of one node; the same in every run of the block and its noise."""

    def attack_seed(self) -> int:
        """Return the key of the attack's own, counter-based randomness."""

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON values."""

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe from the result of ``to_dict``."""


class TestbedRun(Protocol):
    """A testbed that has started, and its one run.

    Attributes
    ----------
    domain : Domain
        The system's graph.
    node : ScenarioNode or None
        The mode's node; None until it exists.
    """

    domain: Domain
    node: ScenarioNode | None

    def go(self) -> None:
        """Execute the run; write bag and graphs."""

    def manifest(self, wall_s: float, software: Software) -> Manifest:
        """Return the facts of the finished run for its manifest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Testbed:
    """A testbed: how its runs are drawn and executed.

    Parameters
    ----------
    experiments
        Built-in scenarios that are modes, in the order in which they are shown. The shadow controls
        of the attacks among them follow.
    hard_negatives
        Built-in scenarios that are normal but look unusual, with the changed conditions.
    messages
        Packages whose messages only this testbed has. A scenario that reads one of them runs here,
        every other in the first testbed.
    recipe
        Class of the recipes.
    draw
        Draws the recipe of a mode's run of a campaign, given values for parameters.
    bring_up
        Starts the system for one run, which is written into an existing and empty folder.
    made_by
        The module with the class of runs. It and its imports are the software of a run.
    """

    experiments: tuple[str, ...]
    hard_negatives: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    messages: frozenset[str] = frozenset()
    recipe: type[Recipe]
    draw: Callable[[Mode, int, Campaign, Mapping[str, Any]], Recipe]
    bring_up: Callable[[Any, Path], TestbedRun]
    made_by: str

    def made(self, recipe: Mapping[str, Any]) -> bool:
        """Return whether a recorded recipe is one of this testbed's, by its keys."""
        return recipe.keys() == {item.name for item in fields(self.recipe)}
