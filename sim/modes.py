"""The experiment modes: scenarios, and under which conditions of the testbed they are run.

The scenario file of a mode states what its node does to the attacked topic, when, and the label of
the runs. Modes are the six of the experiments that this project reproduces, shadow controls of
their attacks, hard negatives, the scenarios in the folder ``ORACLE_SCENARIOS``, and those of the
second testbed. See docs/reference/modes.md.
"""

import functools
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from sim.campaigns import is_set
from sim.fuzzing.compilation import compile_file, compile_scenario
from sim.fuzzing.scenario import Scenario, ScenarioError, load_scenarios
from sim.scenarios import builtin_scenarios
from sim.testbed import Mode
from sim.testbeds import TESTBEDS, which_testbed

FOLDER = "ORACLE_SCENARIOS"  # environment variable: the user's folder of scenario files
ACTUATION = "ORACLE_ALLOW_ACTUATION"  # 1: scenarios may send commands to motors
SUFFIXES = (".yaml", ".yml")  # of scenario files


def modes() -> Mapping[str, Mode]:
    """Return every mode by name, in the order in which they are shown."""
    return _in_environment()[0]


def broken_scenarios() -> tuple[str, ...]:
    """Return the errors in files of the user's folder, which do not become modes."""
    return _in_environment()[1]


def find_mode(name: str, *, allow_actuation: bool = False) -> Mode:
    """Return a mode by its name, that of any built-in scenario, or that of a scenario file.

    A file that holds several scenarios is followed by ``#`` and the name of one.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or it is invalid.
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


def _in_environment() -> tuple[Mapping[str, Mode], tuple[str, ...]]:
    return _modes(os.environ.get(FOLDER), allow_actuation=is_set(ACTUATION))


@functools.cache
def _modes(
    folder: str | None, *, allow_actuation: bool
) -> tuple[Mapping[str, Mode], tuple[str, ...]]:
    """Return the modes with those of a folder of scenario files, and the errors in it."""
    builtins = builtin_scenarios()
    found: list[Mode] = []
    for testbed in TESTBEDS.values():
        experiments = [builtins[name] for name in testbed.experiments]
        found += map(Mode, [*experiments, *_shadows(experiments)])
        found += (Mode(builtins[name], what) for name, what in testbed.hard_negatives.items())
    own: list[Scenario] = []
    broken: list[str] = []
    if folder:
        taken = [mode.id for mode in found]
        own, broken = _in_folder(Path(folder), taken, allow_actuation=allow_actuation)
    found += map(Mode, own)
    found.sort(key=lambda mode: list(TESTBEDS).index(which_testbed(mode.scenario)))
    return MappingProxyType({mode.id: mode for mode in found}), tuple(broken)


def _shadows(scenarios: Iterable[Scenario]) -> list[Scenario]:
    return [scenario.as_shadow() for scenario in scenarios if scenario.label == "malicious"]


def _in_folder(
    folder: Path, taken: Iterable[str], *, allow_actuation: bool
) -> tuple[list[Scenario], list[str]]:
    """Return the scenarios of a folder, and the errors of those that are left out."""
    try:
        files = sorted(file for file in folder.iterdir() if file.suffix in SUFFIXES)
    except OSError as error:
        return [], [f"{FOLDER} is {folder}, which is no folder: {error}; name one, or unset it."]
    scenarios: dict[str, Scenario] = {}
    broken: list[str] = []
    for file in files:
        try:
            programs = compile_file(file, allow_actuation=allow_actuation)
            for scenario in (program.scenario for program in programs):
                if scenario.id in {*taken, *scenarios}:
                    raise scenario.error(
                        ("id",), f"expected a new name, there is a mode {scenario.id} already"
                    )
                scenarios[scenario.id] = scenario
        except ScenarioError as error:
            broken.append(str(error))
    return list(scenarios.values()), broken
