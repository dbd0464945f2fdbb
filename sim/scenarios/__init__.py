"""The built-in scenarios, a YAML file each, which the built-in modes use.

A recipe holds its scenario, so a run does not depend on this folder.
"""

import functools
from collections.abc import Mapping
from importlib.resources import files

from sim.fuzzing.scenario import Scenario, load_scenarios


@functools.cache
def builtin_scenarios() -> Mapping[str, Scenario]:
    """Return the scenarios that come with the testbeds, by name, in the order of their files."""
    return {
        scenario.id: scenario
        for file in sorted(files(__package__).iterdir(), key=lambda file: file.name)
        if file.name.endswith(".yaml")
        for scenario in load_scenarios(file)
    }
