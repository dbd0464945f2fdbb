"""One run: the protocol from the first node to the last goal, and its run directory.

The robot comes up, is told where it is, and once Nav2 is active the recorder starts; the client
then sends the patrol's goals. The run ends a moment after the last goal's result, after an abort,
or when time is up. World, nodes and loop meet here and nowhere else.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from oracle_pipeline.bags import manifest as schema
from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    GRAPHS_FOLDER,
    RunDirectory,
    bytes_on_disk,
)
from oracle_pipeline.bags.writer import BagWriter
from sim.fuzzing.relays import INPUT_TOPIC, FakeObject, FakeObjectRelay, NoiseRelay, Relay
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.modes import DELAY_S, modes
from sim.nav2.basic_navigator import GoalResult
from sim.nav2.bringup import bring_up
from sim.nav2.collision_monitor import SOURCES
from sim.odometer import Odometer
from sim.pairs import judge_pair
from sim.protocol import make
from sim.recipes import Recipe
from sim.recording import DEBUG_TOPICS, GraphRecorder, ReceiveClock, Recorder
from sim.software import software
from sim.turtlebot3 import frames
from sim.turtlebot3.map import WORLD_IN_MAP, odom_in_map, turtlebot3_world_map
from sim.turtlebot3.nodes import LidarNoise, add_robot
from sim.turtlebot3.world import World, WorldParameters

BRING_UP_NS = 20 * SECOND  # Nav2 must be active by then
BEFORE_RECORDING_NS = 1 * SECOND  # from an active Nav2 to the recorder's start
BEFORE_FIRST_GOAL_NS = 2 * SECOND  # from the recorder's start to the first goal
AFTER_LAST_GOAL_NS = 2 * SECOND


class BringUpError(RunDirectoryError):
    """Nav2 did not become active."""


def record_run(recipe: Recipe, directory: RunDirectory, *, refresh: bool = False) -> Manifest:
    """Make one run, whole or not at all.

    Parameters
    ----------
    recipe
        What to make.
    directory
        Where; its mode and run are the recipe's.
    refresh
        Simulate again what is there already.

    Returns
    -------
    Manifest
        Of the new run, or of the one that is there already if it was made from this recipe and
        is whole.

    Raises
    ------
    RunDirectoryError
        If the place holds a run of another recipe, or a damaged one.
    OracleError
        If the run cannot be written; its place is left as it was.
    """
    if directory.is_complete() and not refresh:
        return _verified(directory, recipe)
    make(directory, lambda folder: Run(recipe, folder))
    judge_pair(directory)
    return directory.manifest()


def _verified(directory: RunDirectory, recipe: Recipe) -> Manifest:
    """Return the manifest of a finished run, if it is this recipe's and nothing is missing."""
    found = directory.manifest()
    if Recipe.from_dict(found.recipe) != recipe:
        raise RunDirectoryError(
            f"{directory.path} was made from another recipe (seed {found.seed}, "
            f"{len(found.goals)} goals); refresh it, or choose another root for this campaign."
        )
    sizes = bytes_on_disk(directory.path)
    if sizes != found.measured.bytes:
        raise RunDirectoryError(
            f"{directory.path} is damaged: its parts should have {dict(found.measured.bytes)} "
            f"bytes and have {sizes}; refresh it to make it again."
        )
    return found


class Run:
    """A testbed that has come up, and the one run that is made in it.

    Parameters
    ----------
    recipe
        What to make.
    folder
        Existing and empty; gets ``bag`` and ``graphs``.
    """

    def __init__(self, recipe: Recipe, folder: Path) -> None:
        self._recipe = recipe
        self._mode = modes()[recipe.mode]
        self._folder = folder
        session, options = recipe.session, recipe.options
        self._latency_ns = round(session.latency_ms * MILLISECOND)
        self._world = World(
            WorldParameters(
                WORLD_IN_MAP.inverse().compose(recipe.start), session.friction, session.mass
            )
        )
        self._executor = Executor(on_advance=self._world.advance_to)
        self._domain = Domain(self._executor)
        noise = LidarNoise(session.lidar_noise_m, session.lidar_bias_m)
        add_robot(
            self._domain,
            self._world,
            noise,
            recipe.generator,
            odometry_source=options.odometry_source,
            cameras=options.cameras,
        )
        self._nav2 = bring_up(
            self._domain,
            turtlebot3_world_map(),
            generator=recipe.generator,
            latency_ns=self._latency_ns,
            run=recipe.run,
            monitored=[
                source
                for source in SOURCES
                if not (options.wiring == "replace" and source.topic == INPUT_TOPIC)
            ],
        )
        self._odometer = Odometer(self._executor, lambda: self._world.pose)
        self._patrol_over = False
        self._start_ns = 0  # of the recording
        self._end_ns = 0
        self._onset_ns: int | None = None

    def go(self) -> None:
        """Bring Nav2 up, record the patrol, write bag and graphs."""
        navigator = self._nav2.navigator
        navigator.set_initial_pose(self._recipe.start)
        self._executor.run_until(BRING_UP_NS, stop=lambda: self._nav2.is_active)
        if not self._nav2.is_active:
            raise BringUpError(f"Nav2 was not active after {BRING_UP_NS // SECOND} s; see /rosout.")
        if not self._mode.delayed:
            self._start_relay()
        self._executor.run_until(self._executor.now_ns + BEFORE_RECORDING_NS)
        self._start_ns = self._executor.now_ns
        graphs = self._folder / GRAPHS_FOLDER
        graphs.mkdir()
        with BagWriter(self._folder / BAG_FOLDER, self._recipe.storage) as self._bag:
            options = self._recipe.options
            Recorder(
                self._domain,
                self._bag,
                leave_out=() if options.debug_topics else DEBUG_TOPICS,
                hidden_topics=options.hidden_topics,
                receive_clock=self._receive_clock() if options.receive_stamps else None,
            )
            graph = GraphRecorder(self._domain, graphs)
            self._executor.run_until(self._start_ns + BEFORE_FIRST_GOAL_NS)
            navigator.follow(self._recipe.goals, self._on_patrol_over, self._on_goal_accepted)
            timeout_ns = self._start_ns + round(self._recipe.timeout_s * SECOND)
            self._executor.run_until(timeout_ns, stop=lambda: self._patrol_over)
            if self._patrol_over:
                self._executor.run_until(self._executor.now_ns + AFTER_LAST_GOAL_NS)
            self._end_ns = self._executor.now_ns
            graph.finish()

    def manifest(self, wall_s: float) -> Manifest:
        """Return what the finished run was."""
        recipe, mode = self._recipe, self._mode
        results = tuple(
            map(self._goal_result, self._nav2.navigator.results, self._odometer.distances())
        )
        # The worst of the goals': one that was never reached counts for those never sent.
        worst: schema.Outcome = next(
            (result.outcome for result in results if result.outcome != "succeeded"), "succeeded"
        )
        return Manifest(
            mode=mode.id,
            label=mode.label,
            run=recipe.run,
            block=recipe.block,
            session=recipe.session.index,
            seed=recipe.seed,
            start=_pose(recipe.start),
            goals=tuple(map(_pose, recipe.goals)),
            goal_results=results,
            outcome=worst,
            onset_s=None if self._onset_ns is None else self._seconds(self._onset_ns),
            attack=self._attack(),
            scenario=mode.id,
            scenario_hash=hashlib.sha256(repr(mode).encode()).hexdigest(),
            task_effect=None,  # until the run and its control are both there
            recording_s=self._seconds(self._end_ns),
            contacts=tuple(
                schema.Contact(self._seconds(touch.stamp_ns), touch.piece)
                for touch in self._world.touches
            ),
            topics=self._bag.topics,
            content_hash=self._bag.content_hash,
            recipe=recipe.to_dict(),
            software=software(),
            measured=schema.Measured(wall_s=wall_s, bytes=bytes_on_disk(self._folder)),
        )

    def _attack(self) -> Mapping[str, Any]:
        """Return what was drawn for the mode's attack."""
        if self._mode.operation == "fake_object":
            return {"frame": "odom", **asdict(self._fake_object())}
        if self._mode.operation == "random_noise":
            return {"level": self._recipe.noise_level}
        return {}

    def _on_patrol_over(self) -> None:
        self._patrol_over = True

    def _on_goal_accepted(self, _result: GoalResult) -> None:
        self._odometer.mark()
        first = len(self._nav2.navigator.results) == 1
        if first and self._mode.delayed:
            due_ns = self._executor.now_ns + round(DELAY_S * SECOND)
            self._executor.call_at(due_ns, self._start_relay)

    def _start_relay(self) -> None:
        """Put the mode's node into the graph."""
        latency_ns, mode, recipe = self._latency_ns, self._mode, self._recipe
        if recipe.options.wiring == "absent":
            return
        self._onset_ns = self._executor.now_ns
        if mode.operation == "fake_object":
            x, y, _ = frames.BASE_SCAN_TOM.xyz
            FakeObjectRelay(
                self._domain,
                target=self._fake_object(),
                mount=Pose2D(x, y),
                latency_ns=latency_ns,
                shadow=mode.shadow,
            )
        elif mode.operation == "random_noise":
            NoiseRelay(
                self._domain,
                level=recipe.noise_level,
                seed=recipe.attack_seed(),
                with_odometry=mode.with_odometry,
                latency_ns=latency_ns,
                shadow=mode.shadow,
            )
        else:
            Relay(self._domain, with_odometry=mode.with_odometry, latency_ns=latency_ns)

    def _fake_object(self) -> FakeObject:
        """Return where the fake object is for its node, which knows the odometry frame only."""
        recipe = self._recipe
        odom = odom_in_map(recipe.options.odometry_source, recipe.start)
        drawn = recipe.fake_object
        there = odom.inverse().compose(Pose2D(drawn.x, drawn.y))
        return replace(drawn, x=there.x, y=there.y)

    def _receive_clock(self) -> ReceiveClock:
        rng = self._recipe.generator("/rosbag2_recorder")
        return ReceiveClock(self._executor.now_ns, rng)

    def _goal_result(self, result: GoalResult, driven_m: float) -> schema.GoalResult:
        ended_s = None if result.ended_ns is None else self._seconds(result.ended_ns)
        outcome: schema.Outcome = "timeout"  # the run ended before the goal did
        if result.outcome is not None:
            outcome = "succeeded" if result.outcome == "succeeded" else "aborted"
        return schema.GoalResult(
            self._seconds(result.accepted_ns),
            ended_s,
            outcome,
            driven_m,
            result.number_of_recoveries,
        )

    def _seconds(self, time_ns: int) -> float:
        """Return a time in seconds of the recording; what was before it began is at 0."""
        return max(time_ns - self._start_ns, 0) / SECOND


def _pose(pose: Pose2D) -> schema.Pose:
    return schema.Pose(pose.x, pose.y, pose.yaw)
