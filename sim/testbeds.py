"""The list of testbeds. To add one, make a folder like these two, and add a line here."""

from collections.abc import Mapping

from sim.atc.testbed import AIR_TRAFFIC_CONTROL
from sim.fuzzing.scenario import Scenario
from sim.testbed import Testbed
from sim.turtlebot3.testbed import TURTLEBOT3

TESTBEDS: Mapping[str, Testbed] = {
    "turtlebot3": TURTLEBOT3,
    "atc": AIR_TRAFFIC_CONTROL,
}


def which_testbed(scenario: Scenario) -> str:
    """Return the name of the testbed in which a scenario is run."""
    package = scenario.document["main"]["type"].partition("/")[0]
    first = next(iter(TESTBEDS))
    return next((name for name, bed in TESTBEDS.items() if package in bed.messages), first)
