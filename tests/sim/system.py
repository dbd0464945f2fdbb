"""The testbed as a run starts it, and its documented differences from the real one, for tests of
its interfaces."""

import re
from pathlib import Path

import numpy as np

from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.nav2.bringup import bring_up
from sim.recording import DEBUG_TOPICS, Recorder
from sim.scenarios import builtin_scenarios
from sim.turtlebot3.arena import HEXAGON
from sim.turtlebot3.map import WORLD_IN_MAP, occupancy_map
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.nodes import add_robot
from sim.turtlebot3.run import NODE
from sim.turtlebot3.sensors import SensorErrors
from sim.turtlebot3.world import World
from tests.sim import humble

DOC = Path(__file__).parents[2] / "docs" / "explanation" / "testbed.md"
RUN = 7
START = Pose2D(-2.0, -0.5)  # in the world
BRING_UP_NS = 10 * SECOND
LATENCY_NS = 2 * MILLISECOND


def documented(section):
    """Return node -> the other columns of the table in a section of the page, topics as lists."""
    text = DOC.read_text().partition(f"## {section}\n")[2].partition("\n## ")[0]
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| `")]
    return {
        node.strip(" `"): [re.findall(r"`(/\w+)`", cell) or cell.strip() for cell in cells]
        for node, *cells in rows
    }


MORE = documented("More than on Humble")  # node -> codes, publishes, subscribes, reason
LESS = documented("Less than on Humble")  # node -> missing subscriptions, reason
ADDED_NODES = [node for node in MORE if node not in humble.NODES]
NODES = [*humble.NODES, *ADDED_NODES]


class System:
    """World, robot and Nav2, not yet active."""

    def __init__(self, run=RUN):
        self.world = World(WorldParameters(START))
        self.executor = Executor(on_advance=self.world.advance_to)
        self.domain = Domain(self.executor)

        def generator(node):
            return np.random.default_rng([run, *node.encode()])

        add_robot(self.domain, self.world, SensorErrors(), generator)
        self.nav2 = bring_up(
            self.domain, occupancy_map(HEXAGON), generator=generator, latency_ns=LATENCY_NS, run=run
        )
        self.nav2.navigator.set_initial_pose(WORLD_IN_MAP.compose(START))

    def activate(self, watch=lambda: None):
        """Run until Nav2 is active; ``watch()`` is called after every callback."""

        def is_over():
            watch()
            return self.nav2.is_active

        self.executor.run_until(BRING_UP_NS, stop=is_over)

    def complete(self, bag):
        """Add what a run adds to an active Nav2: the mode's node and the recorder."""
        passthrough = compile_scenario(builtin_scenarios()["lidar_passthrough_odom"])
        ScenarioNode(self.domain, NODE, execute(passthrough, 0), latency_ns=LATENCY_NS)
        Recorder(self.domain, bag, leave_out=DEBUG_TOPICS)

    def run(self, seconds):
        """Let time pass."""
        self.executor.run_until(self.executor.now_ns + round(seconds * SECOND))
