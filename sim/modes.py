"""The experiment modes: scenarios, and under which conditions of the testbed they are run.

What a mode's node does to the attacked topic, when, and how the runs are labelled stands in the
mode's scenario file. Modes are the six of the experiments that this project reproduces, shadow
controls of their attacks, hard negatives, whatever the folder ``ORACLE_SCENARIOS`` holds, and the
second testbed's. See docs/reference/modes.md.
"""

import functools
import itertools
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from oracle_pipeline.bags.manifest import Label
from sim.fuzzing.program import compile_scenario
from sim.fuzzing.scenario import Scenario, ScenarioError, load_scenarios
from sim.scenarios import builtin_scenarios

FOLDER = "ORACLE_SCENARIOS"  # the environment's name of the user's folder of scenario files

Testbed = Literal["turtlebot3", "atc"]


@dataclass(frozen=True, slots=True)
class Conditions:
    """What is otherwise in the TurtleBot3 testbed; a scenario can change messages only."""

    obstacle: bool = False  # a real cylinder, on no map, where the block's fake object would be
    speed: float = 1.0  # share of its maximal speed that the robot may drive and turn at


@dataclass(frozen=True, slots=True)
class Mode:
    """One experiment."""

    scenario: Scenario
    conditions: Conditions = Conditions()

    @property
    def id(self) -> str:
        """Name of the mode: the scenario's."""
        return self.scenario.id

    @property
    def label(self) -> Label:
        """How its runs are labelled."""
        return self.scenario.label

    @property
    def title(self) -> str:
        """What it does, in a line."""
        return self.scenario.title

    @property
    def testbed(self) -> Testbed:
        """Where it is run: on the one that has the messages that it hears."""
        return "atc" if self.scenario.document["main"]["type"].startswith("atc_") else "turtlebot3"

    @property
    def drawn(self) -> Mapping[str, str]:
        """Parameters whose value comes from the block: name -> what of the block."""
        parameters = self.scenario.document.get("parameters", {})
        return {name: spec["drawn"] for name, spec in parameters.items() if "drawn" in spec}

    @property
    def has_object(self) -> bool:
        """Whether it shows the robot the block's object that is not there."""
        return "object_x" in self.drawn.values()

    def parameters(self, block: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
        """Return a value for every parameter: that given, else the block's, else the default.

        Parameters
        ----------
        block
            What the block has drawn.
        given
            Values by name of parameter; whether they fit is seen when the scenario is run.

        Raises
        ------
        ScenarioError
            If a parameter asks for what a block of this testbed has not.
        """
        defaults = {
            name: spec["default"]
            for name, spec in self.scenario.document.get("parameters", {}).items()
        }
        for name, what in self.drawn.items():
            if what not in block:
                raise self.scenario.error(
                    ("parameters", name, "drawn"),
                    f"expected what a block of this testbed has, {', '.join(block)}, found {what}",
                )
        of_block = {name: block[what] for name, what in self.drawn.items()}
        return {**defaults, **of_block, **given}


_THESIS = (
    "lidar_passthrough",
    "lidar_passthrough_odom",
    "fake_object",
    "random_noise",
    "delayed_passthrough",
    "delayed_fakeobject",
)
_HARD_NEGATIVES = MappingProxyType(
    {
        "benign_median": Conditions(),
        "benign_noise": Conditions(),
        "benign_drop": Conditions(),
        "benign_obstacle": Conditions(obstacle=True),
        "benign_slow": Conditions(speed=0.6),
    }
)
_AIR_TRAFFIC_CONTROL = "atc_normal"

PAIRS: tuple[tuple[str, str], ...] = (
    ("lidar_passthrough", "random_noise"),
    ("lidar_passthrough_odom", "fake_object"),
    ("delayed_passthrough", "delayed_fakeobject"),
)
"""Control and attack whose graphs are equal by construction."""


def modes() -> Mapping[str, Mode]:
    """Return every mode by name, in the order in which they are shown."""
    return _modes(os.environ.get(FOLDER))[0]


def broken_scenarios() -> tuple[str, ...]:
    """Return what is wrong with files of the user's folder; they are no modes."""
    return _modes(os.environ.get(FOLDER))[1]


def find_mode(name: str, *, allow_actuation: bool = False) -> Mode:
    """Return a mode by its name, that of any built-in scenario, or that of a scenario file.

    A file that holds several scenarios is followed by ``#`` and the name of one.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or it is wrong.
    """
    known, builtins = modes(), builtin_scenarios()
    if name in known:
        return known[name]
    scenario = builtins[name] if name in builtins else _in_file(name)
    compile_scenario(scenario, allow_actuation=allow_actuation)
    return Mode(scenario)


def _in_file(name: str) -> Scenario:
    file, _, chosen = name.partition("#")
    if not Path(file).is_file():
        raise ScenarioError(
            f"There is neither a scenario nor a file {file}; "
            f"built in are {', '.join(builtin_scenarios())}."
        )
    scenarios = {scenario.id: scenario for scenario in load_scenarios(Path(file))}
    if not chosen and len(scenarios) == 1:
        (chosen,) = scenarios
    if chosen not in scenarios:
        raise ScenarioError(f"{file} holds {', '.join(scenarios)}; choose one as {file}#<name>.")
    return scenarios[chosen]


@functools.cache
def _modes(folder: str | None) -> tuple[Mapping[str, Mode], tuple[str, ...]]:
    """Return the modes with those of a folder of scenario files, and what is wrong in it."""
    builtins = builtin_scenarios()
    thesis = [builtins[name] for name in _THESIS]
    air_traffic = [builtins[_AIR_TRAFFIC_CONTROL]] + [
        scenario
        for name, scenario in builtins.items()
        if name.startswith("atc_") and name != _AIR_TRAFFIC_CONTROL
    ]
    found = [
        *map(Mode, itertools.chain(thesis, _shadows(thesis))),
        *(Mode(builtins[name], conditions) for name, conditions in _HARD_NEGATIVES.items()),
        *map(Mode, itertools.chain(air_traffic, _shadows(air_traffic))),
    ]
    own, broken = _in_folder(Path(folder), [mode.id for mode in found]) if folder else ([], [])
    found += map(Mode, own)
    found.sort(key=lambda mode: mode.testbed == "atc")
    return MappingProxyType({mode.id: mode for mode in found}), tuple(broken)


def _shadows(scenarios: Iterable[Scenario]) -> list[Scenario]:
    return [scenario.as_shadow() for scenario in scenarios if scenario.label == "malicious"]


def _in_folder(folder: Path, taken: Iterable[str]) -> tuple[list[Scenario], list[str]]:
    """Return the scenarios of a folder, and the errors of those that are left out."""
    if not folder.is_dir():
        return [], [f"{FOLDER} is {folder}, which is no folder; name one, or unset it."]
    scenarios: dict[str, Scenario] = {}
    broken: list[str] = []
    for file in sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")]):
        try:
            for scenario in load_scenarios(file):
                if scenario.id in {*taken, *scenarios}:
                    raise scenario.error(
                        ("id",), f"expected a new name, there is a mode {scenario.id} already"
                    )
                compile_scenario(scenario)
                scenarios[scenario.id] = scenario
        except ScenarioError as error:
            broken.append(str(error))
    return list(scenarios.values()), broken
