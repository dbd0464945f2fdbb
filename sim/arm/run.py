"""One run of the arm: cell, controllers, MoveIt and program, from start to run directory.

Only this module combines world, nodes and event loop.
"""

from pathlib import Path
from typing import Any

from oracle_pipeline.bags import manifest as schema
from sim.arm.commander import PickAndPlace
from sim.arm.conditions import CONDITIONS, PLANNED_SPEED
from sim.arm.controllers import ControllerManager
from sim.arm.move_group import MoveGroup
from sim.arm.perception import ObjectDetector, RobotStatePublisher
from sim.arm.recipes import ArmRecipe
from sim.arm.world import World
from sim.conditions import declare
from sim.goal_run import GoalRun, Odometer
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, Executor


class ArmRun(GoalRun):
    """The testbed, for one run."""

    NODE = "/joint_state_relay"
    _recipe: ArmRecipe
    _commander: PickAndPlace

    def __init__(self, recipe: ArmRecipe, folder: Path) -> None:
        super().__init__(recipe, folder)
        session, draws, detector = recipe.session, recipe.generator, "/object_detector"
        self._latency_ns = latency_ns = round(session.latency_ms * MILLISECOND)
        self._world = world = World(recipe, draws("/world"))
        self._executor = Executor(on_advance=world.advance_to)
        self.domain = domain = Domain(self._executor)
        RobotStatePublisher(domain)
        ControllerManager(domain, world, latency_ns)
        ObjectDetector(domain, world.object_pose, session, recipe.obstacle, draws(detector))
        self._move_group = MoveGroup(domain, latency_ns)
        self._commander = PickAndPlace(domain, latency_ns)
        declare(domain, CONDITIONS, self._change)
        self._odometer = Odometer(self._executor, lambda: world.tool().tolist())

    def _change(self, condition: str, value: float) -> None:
        if condition == PLANNED_SPEED:
            self._move_group.speed = value
        else:
            self._world.change(condition, value)

    def go(self) -> None:
        """Record the run, and write bag and graphs."""
        cell, recipe = self._commander, self._recipe
        self._conduct(lambda: cell.run(recipe.places, self._on_goal), recipe.timeout_s)

    def _results(self) -> dict[str, Any]:
        touched = ((self._seconds(at_ns), name) for at_ns, name in self._world.touched)
        return {
            **super()._results(),
            "session": self._recipe.session.index,
            "world": "cell",
            "start": self._recipe.start,
            "goals": self._recipe.places,
            "contacts": tuple(schema.Contact(*each) for each in touched),
        }
