"""The built-in scenarios, a YAML file each, which the built-in modes use.

A recipe holds its scenario, so a run does not depend on this folder.
"""

import functools
from collections.abc import Mapping
from pathlib import Path

from sim.fuzzing.scenario import Scenario, load_scenarios


def builtin_scenarios() -> Mapping[str, Scenario]:
    """Return the scenarios that come with the testbeds, by name, in the order of their files."""
    return scenarios_in(Path(__file__).parent)


@functools.cache
def scenarios_in(folder: Path) -> Mapping[str, Scenario]:
    """Return the scenarios of a folder, by name, in the order of its files.

    Raises
    ------
    ScenarioError
        If a file is invalid.
    """
    return {
        scenario.id: scenario
        for file in sorted(folder.glob("*.yaml"))
        for scenario in load_scenarios(file)
    }
