"""One flight: Crazyflie, motion capture, server and commander, from start to run directory.

The recorder starts before the take-off. The run ends shortly after the landing, or at its time
limit. Only this module combines world, nodes and event loop.
"""

from pathlib import Path
from typing import Any

import numpy as np

from oracle_pipeline.bags import manifest as schema
from sim.conditions import declare
from sim.crazyflie.commander import FlightCommander
from sim.crazyflie.conditions import CONDITIONS
from sim.crazyflie.firmware import Firmware
from sim.crazyflie.recipes import CrazyflieRecipe
from sim.crazyflie.server import CrazyflieServer
from sim.crazyflie.tracking import MotionCapture
from sim.crazyflie.world import START_Z, World
from sim.goal_run import GoalRun, Odometer
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, Executor


class CrazyflieRun(GoalRun):
    """The testbed, for one flight."""

    NODE = "/pose_relay"
    _recipe: CrazyflieRecipe
    _commander: FlightCommander

    def __init__(self, recipe: CrazyflieRecipe, folder: Path) -> None:
        super().__init__(recipe, folder)
        session, draws = recipe.session, recipe.generator
        self._latency_ns = latency_ns = round(session.latency_ms * MILLISECOND)
        firmware = Firmware(np.array([0.0, 0.0, START_Z]), session.gains)
        self._world = world = World(session.craft, firmware.step, draws("/world"))
        self._executor = Executor(on_advance=world.advance_to)
        self.domain = domain = Domain(self._executor)
        MotionCapture(domain, world.pose, session, draws("/motion_capture_tracking"))
        CrazyflieServer(domain, firmware, world.volts, draws("/crazyflie_server"), latency_ns)
        self._commander = FlightCommander(domain, latency_ns)
        declare(domain, CONDITIONS, world.change)
        self._odometer = Odometer(self._executor, lambda: world.pose()[0].tolist())

    def go(self) -> None:
        """Record the flight, and write bag and graphs."""
        flight, recipe = self._commander, self._recipe
        self._conduct(lambda: flight.fly(recipe.legs, self._on_goal), recipe.timeout_s)

    def _results(self) -> dict[str, Any]:
        return {
            **super()._results(),
            "session": self._recipe.session.index,
            "world": "room",
            "goals": tuple(schema.Pose(leg.x, leg.y, leg.yaw) for leg in self._recipe.legs),
            "drive": schema.Drive(None, 0, 0),
            "contacts": tuple(
                schema.Contact(self._seconds(hit_ns), "floor") for hit_ns in self._world.hits_ns
            ),
        }
