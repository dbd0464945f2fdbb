"""The testbeds by name: those that come with this project, plug-ins, and files of commands.

The first two are entry points of one group. One that cannot be loaded is left out, with its error.
"""

import os
import re
from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path
from typing import Any, NamedTuple

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.sources import dependencies
from sim.fuzzing.scenario import Scenario
from sim.outside.testbed import FOLDER, read_testbed
from sim.testbed import Testbed

GROUP = "oracle_sim.testbeds"
BUILT_IN = {
    "turtlebot3": "sim.turtlebot3.testbed:TURTLEBOT3",
    "atc": "sim.atc.testbed:AIR_TRAFFIC_CONTROL",
    "crazyflie": "sim.crazyflie.testbed:CRAZYFLIE",
    "arm": "sim.arm.testbed:ARM",
}


_NAME = re.compile("[a-z][a-z0-9_]*")


class TestbedError(OracleError):
    """A testbed does not exist, or cannot be loaded."""


class TestbedFile(NamedTuple):
    """A testbed of commands, in a YAML file: like an entry point."""

    name: str
    value: str  # path of the file

    def load(self) -> Testbed:
        """Return the testbed."""
        return read_testbed(Path(self.value))


def _testbed_files() -> list[TestbedFile]:
    """Return the files in the user's folder."""
    folder = os.environ.get(FOLDER)
    files = sorted(Path(folder).glob("*.yaml")) if folder else []
    return [TestbedFile(file.stem, str(file)) for file in files]


def load_testbeds(
    points: Iterable[EntryPoint | TestbedFile],
) -> tuple[dict[str, Testbed], tuple[str, ...]]:
    """Return the testbeds of some places by name, and the errors of those that are left out."""
    testbeds: dict[str, Testbed] = {}
    broken = []
    for point in points:
        try:
            if not _NAME.fullmatch(point.name):
                raise TestbedError("its name may have small letters, digits and underscores only")
            if point.name in testbeds:
                raise TestbedError("there is a testbed of this name already; choose another")
            testbeds[point.name] = _loaded(point)
        except Exception as error:  # whatever foreign code raises
            reason = str(error) if isinstance(error, OracleError) else repr(error)
            broken.append(f"Testbed {point.name} ({point.value}): {reason}.")
    return testbeds, tuple(broken)


def _loaded(point: EntryPoint | TestbedFile) -> Testbed:
    """Return the testbed of an entry point."""
    testbed = point.load()
    if not isinstance(testbed, Testbed):
        raise TestbedError(f"expected a sim.testbed.Testbed, found {type(testbed).__name__}")
    if point.name not in BUILT_IN:  # the tests do it for ours
        dependencies([testbed.made_by])  # raises an error if a module of it cannot be read
    for library in testbed.libraries:
        version(library)  # raises an error if it is not installed
    return testbed


TESTBEDS, BROKEN_TESTBEDS = load_testbeds(
    [
        *(EntryPoint(name, place, GROUP) for name, place in BUILT_IN.items()),
        *sorted(entry_points(group=GROUP), key=lambda point: (point.name, point.value)),
        *_testbed_files(),
    ]
)


def which_testbed(scenario: Scenario) -> str:
    """Return the name of the testbed in which a scenario is run.

    Raises
    ------
    ScenarioError
        If the testbed that it names does not exist.
    """
    try:
        return testbed_of(scenario.document)
    except TestbedError as error:
        raise scenario.error(("testbed",), str(error)) from error


def testbed_of(document: Mapping[str, Any]) -> str:
    """Return the name of the testbed in which the scenario of a document is run.

    It names one, or reads messages that only one has; every other runs in the first testbed.

    Raises
    ------
    TestbedError
        If the testbed that it names does not exist.
    """
    package = document["main"]["type"].partition("/")[0]
    first = next(iter(TESTBEDS))
    only = next((name for name, bed in TESTBEDS.items() if package in bed.messages), first)
    named = str(document.get("testbed", only))
    require_testbed(named)
    return named


def require_testbed(name: str) -> Testbed:
    """Return a testbed by its name.

    Raises
    ------
    TestbedError
        If it does not exist.
    """
    if name not in TESTBEDS:
        raise TestbedError(
            f"There is no testbed {name!r}; there are {', '.join(TESTBEDS)}. Install its plug-in."
        )
    return TESTBEDS[name]
