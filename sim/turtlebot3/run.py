"""One run on the TurtleBot3 testbed: robot, Nav2 and recorder, from start to run directory.

The robot starts and gets its initial pose. When Nav2 is active, the recorder starts, and the client
sends the goals of the patrol. The run ends shortly after the result of the last goal, after an
abort, or at its time limit. Only this module combines world, nodes and event loop.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from oracle_pipeline.bags import manifest as schema
from oracle_pipeline.bags.errors import RunDirectoryError
from sim.goal_run import GoalRun, Odometer
from sim.middleware.delays import Delays
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.nav2.bringup import bring_up
from sim.nav2.collision_monitor import SOURCES
from sim.recording import DEBUG_TOPICS, ReceiveClock
from sim.turtlebot3.arena import Cylinder
from sim.turtlebot3.map import WORLD_IN_MAP, occupancy_map
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.nodes import add_robot
from sim.turtlebot3.pedestrian import draw_walk
from sim.turtlebot3.recipes import TurtleBot3Recipe
from sim.turtlebot3.sessions import estimated_start, load, mapped, sensor_errors
from sim.turtlebot3.world import World

BRING_UP_NS = 20 * SECOND  # Nav2 must be active by then
NODE = "/lidar_passthrough"  # name of the mode's node in every mode


class BringUpError(RunDirectoryError):
    """Nav2 did not become active."""


class TurtleBot3Run(GoalRun):
    """The testbed, for one run."""

    NODE = NODE
    AFTER_NS = 2 * SECOND
    _recipe: TurtleBot3Recipe

    def __init__(self, recipe: TurtleBot3Recipe, folder: Path) -> None:
        super().__init__(recipe, folder)
        session, options = recipe.session, recipe.options
        self._latency_ns = round(session.latency_ms * MILLISECOND)
        self._world = World(_world_parameters(recipe))
        self._executor = Executor(on_advance=self._world.advance_to)
        self.domain = Domain(self._executor, self._delays)
        add_robot(
            self.domain,
            self._world,
            sensor_errors(session),
            recipe.generator,
            odometry_source=options.odometry_source,
        )
        self._nav2 = bring_up(
            self.domain,
            mapped(occupancy_map(recipe.arena), recipe.seed, session),
            generator=recipe.generator,
            latency_ns=self._latency_ns,
            run=recipe.run,
            monitored=[
                source
                for source in SOURCES
                if not (
                    options.wiring == "replace"
                    and source.topic in {lane.input_topic for lane in self._program.lanes}
                    and not self._program.is_in_place
                )
            ],
            speed=recipe.conditions.speed,
            stock=options.nav2 == "stock",
            parameters=options.nav2_params,
        )
        self._commander = self._nav2.navigator
        self._odometer = Odometer(self._executor, self._place)

    def go(self) -> None:
        """Start Nav2, record the patrol, and write bag and graphs."""
        navigator = self._nav2.navigator
        recipe = self._recipe
        where = estimated_start(recipe.start, recipe.session, recipe.generator("/initialpose"))
        navigator.set_initial_pose(where)
        self._executor.run_until(BRING_UP_NS, stop=lambda: self._nav2.is_active)
        if not self._nav2.is_active:
            raise BringUpError(
                f"Nav2 was not active after {BRING_UP_NS // SECOND} s; look at /rosout in the bag."
            )
        self._conduct(lambda: navigator.follow(recipe.goals, self._on_goal), recipe.timeout_s)

    def _recorder_options(self) -> dict[str, Any]:
        options, rng = self._recipe.options, self._recipe.generator("/rosbag2_recorder")
        clock = ReceiveClock(self._start_ns, rng) if options.receive_stamps else None
        return {
            "leave_out": DEBUG_TOPICS,
            "hidden_topics": options.hidden_topics,
            "receive_clock": clock,
        }

    def _results(self) -> dict[str, Any]:
        recipe = self._recipe
        return {
            **super()._results(),
            "session": recipe.session.index,
            "world": recipe.world,
            "start": _pose(recipe.start),
            "goals": tuple(map(_pose, recipe.goals)),
            "attack": self._attack(),
            "drive": self._drive(),
            "contacts": tuple(
                schema.Contact(self._seconds(touch.stamp_ns), touch.piece)
                for touch in self._world.touches
            ),
        }

    def _drive(self) -> schema.Drive:
        monitor, places = self._nav2.collision_monitor, self._odometer.places()
        return schema.Drive(
            self._world.clearance(places) if len(places) else None,
            monitor.commands,
            monitor.commands_altered,
        )

    def _attack(self) -> Mapping[str, Any]:
        """Return the scenario's parameters; those of an object are in the odometry frame."""
        parameters = self._recipe.parameters
        has_object = self._program.scenario.has_object
        return {"frame": "odom", **parameters} if has_object else parameters

    def _start_node(self) -> None:
        """Add the mode's node to the graph, unless the campaign leaves it out."""
        if self._recipe.options.wiring != "absent" or self._program.is_in_place:
            super()._start_node()

    def _place(self) -> tuple[float, float]:
        pose = self._world.pose
        return pose.x, pose.y

    def _delays(self, node: str) -> Delays | None:
        """Return the delays that are added to a node's latency."""
        if node == NODE:  # it needs the times at which its messages were sent
            return None
        return Delays(load(self._recipe.session), self._recipe.generator(f"{node} delays"))


def _world_parameters(recipe: TurtleBot3Recipe) -> WorldParameters:
    """Return the parameters of the physics for a run, in the world frame."""
    to_world = WORLD_IN_MAP.inverse()
    start, drawn = to_world.compose(recipe.start), recipe.fake_object
    there = to_world.compose(Pose2D(drawn.x, drawn.y))
    obstacles, walk = [], None
    if recipe.conditions.obstacle:
        obstacles = [Cylinder("obstacle", there.x, there.y, drawn.radius)]
    if recipe.conditions.pedestrian:
        walk = draw_walk(recipe.generator("pedestrian"), recipe.arena, start, there.x, there.y)
    session = recipe.session
    return WorldParameters(
        start, session.friction, session.mass, obstacles, (session.wheel_left, session.wheel_right),
        recipe.arena, walk,
    )  # fmt: skip


def _pose(pose: Pose2D) -> schema.Pose:
    return schema.Pose(pose.x, pose.y, pose.yaw)
