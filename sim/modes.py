"""The experiment modes: scenarios, and under which conditions of the testbed they are run.

The scenario file of a mode states what its node does to the attacked topic, when, and the label of
the runs. Modes are the six of the experiments that this project reproduces, shadow controls of
their attacks, hard negatives, the scenarios in the folder ``ORACLE_SCENARIOS``, and those of other
testbeds. See docs/reference/modes.md.
"""

import functools
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from sim.campaigns import is_set
from sim.fuzzing.compilation import compile_file, compile_scenario
from sim.fuzzing.scenario import Scenario, ScenarioError, load_scenarios
from sim.scenarios import builtin_scenarios, scenarios_in
from sim.testbed import Mode, Testbed
from sim.testbeds import BROKEN_TESTBEDS, BUILT_IN, TESTBEDS, which_testbed

FOLDER = "ORACLE_SCENARIOS"  # environment variable: the user's folder of scenario files
ACTUATION = "ORACLE_ALLOW_ACTUATION"  # 1: scenarios may send commands to motors
SUFFIXES = (".yaml", ".yml")  # of scenario files


def modes() -> Mapping[str, Mode]:
    """Return every mode by name, in the order in which they are shown."""
    return _in_environment()[0]


def left_out() -> tuple[str, ...]:
    """Return the errors of what is not there: testbeds, their modes, and the user's scenarios."""
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
    """Return the modes with those of a folder of scenario files, and the errors."""
    found: dict[str, Mode] = {}
    broken = list(BROKEN_TESTBEDS)
    for name, testbed in TESTBEDS.items():
        try:
            found |= {mode.id: mode for mode in _of_testbed(name, testbed, found)}
        except (ScenarioError, OSError) as error:
            broken.append(f"The modes of testbed {name}: {error}")
    if folder:
        own, faults = _in_folder(Path(folder), found, allow_actuation=allow_actuation)
        found |= {scenario.id: Mode(scenario) for scenario in own}
        broken += faults
    beds = list(TESTBEDS)
    ordered = sorted(found.values(), key=lambda mode: beds.index(which_testbed(mode.scenario)))
    return MappingProxyType({mode.id: mode for mode in ordered}), tuple(broken)


def _of_testbed(name: str, testbed: Testbed, taken: Collection[str]) -> list[Mode]:
    """Return the modes of a testbed; their scenarios are run in it, whatever they read."""
    known = scenarios_in(testbed.scenarios)
    scenarios: dict[str, Scenario] = {}
    for wanted in (*testbed.experiments, *testbed.hard_negatives):
        if wanted not in known or wanted in taken:
            expected = "a new name" if wanted in taken else f"one of {', '.join(known)}"
            raise ScenarioError(f"{testbed.scenarios}: expected {expected}, found {wanted}.")
        scenario = known[wanted]
        if name not in BUILT_IN:
            compile_scenario(scenario)  # the tests do it for ours
        scenarios[wanted] = scenario if which_testbed(scenario) == name else scenario.on(name)
    experiments = [scenarios[each] for each in testbed.experiments]
    hard = (Mode(scenarios[each], what) for each, what in testbed.hard_negatives.items())
    shadows = [each.as_shadow() for each in experiments if each.label == "malicious"]
    return [*map(Mode, [*experiments, *shadows]), *hard]


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
                which_testbed(scenario)  # raises an error if there is none
                if scenario.id in {*taken, *scenarios}:
                    raise scenario.error(
                        ("id",), f"expected a new name, there is a mode {scenario.id} already"
                    )
                scenarios[scenario.id] = scenario
        except ScenarioError as error:
            broken.append(str(error))
    return list(scenarios.values()), broken
