"""What a run is made from: everything that is drawn is drawn here, from the campaign's seed.

Run i of every mode belongs to block i: same start, goals, fake object and nuisance, so that a mode
and its control differ in the mode only. Three sessions take turns; a session is a day in the
laboratory, with its own LiDAR bias, floor and processor load. What the second testbed's runs are
made from is in ``sim.atc.recipes``.
"""

import functools
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from sim.atc.recipes import AtcCampaign, AtcRecipe, atc_recipe_for
from sim.middleware.geometry import Pose2D
from sim.modes import Conditions, Mode, modes
from sim.nav2.costmap import LETHAL, Costmap2D
from sim.nav2.costmap_layers import static_costs
from sim.nav2.footprint import INSCRIBED_RADIUS
from sim.nav2.inflation import GLOBAL_COST_SCALING, InflationLayer
from sim.nav2.navfn import plan
from sim.seeds import generator, node_generator, sequence
from sim.turtlebot3.arena import RING, clearance
from sim.turtlebot3.map import (
    RESOLUTION_M,
    WORLD_IN_MAP,
    OdometrySource,
    odom_in_map,
    turtlebot3_world_map,
)

Storage = Literal["mcap", "sqlite3"]
Wiring = Literal["additive", "replace", "absent"]

DEFAULT_SEED = 20260101
SESSIONS = 3

MIN_CLEARANCE_M = 0.55  # of start and goals from every obstacle; see docs/navigation.md
MIN_LEG_M = 1.5  # straight distance from one goal to the next
FAKE_OBJECT_CLEARANCE_M = 0.6  # of the fake object from start and goals
MIN_DETOUR = 1.35  # the way around the fake object over the way that it lies across
_OBJECT_DRAWS = 100
_FIRST_LATE_LEG = 2  # a delayed attack begins on the second or third leg

# Branches of the seed: what is drawn on one does not move what is drawn on another.
_SESSION, _BLOCK, _NODE, _ATTACK = range(4)


class RecipeError(OracleError):
    """A campaign was asked for something that cannot be drawn."""


@dataclass(frozen=True, slots=True)
class FakeObject:
    """A cylinder that is not there."""

    x: float  # [m]
    y: float  # [m]
    radius: float  # [m]


@dataclass(frozen=True, slots=True)
class Options:
    """What a launch file and ``ros2 bag record`` would be told; by default as on Humble."""

    # How the mode's node stands in the system. Additive: what it publishes is one more source of
    # obstacles, as in the thesis. Replace: the collision monitor hears it instead of the LiDAR
    # that it mutates. Absent: there is no such node.
    wiring: Wiring = "additive"
    odometry_source: OdometrySource = "world"
    cameras: bool = False  # images and points of the depth camera, 15 MB a second
    debug_topics: bool = False  # /evaluation and /marker, 20 MB a second while driving
    hidden_topics: bool = False  # feedback and status of actions
    receive_stamps: bool = False  # bag stamps are the recorder's wall clock, not simulated time


@dataclass(frozen=True, slots=True)
class Campaign:
    """What all runs of a campaign have in common."""

    seed: int = DEFAULT_SEED
    goals_per_run: int = 8  # 1 is the thesis's protocol
    storage: Storage = "mcap"
    timeout_s: float = 600.0  # of simulated time
    options: Options = Options()

    @classmethod
    def from_environment(cls) -> Self:
        """Return the default campaign, with ``ORACLE_GOALS_PER_RUN`` goals a run."""
        text = os.environ.get("ORACLE_GOALS_PER_RUN", "8")
        if not text.isdecimal() or int(text) < 1:
            raise RecipeError(f"ORACLE_GOALS_PER_RUN is {text!r}; give a whole number from 1 on.")
        return cls(goals_per_run=int(text))


@dataclass(frozen=True, slots=True)
class Session:
    """What stays the same for a day and differs from the next."""

    index: int
    lidar_bias_m: float
    lidar_noise_m: float  # standard deviation
    friction: float  # of the floor, relative to the robot's model
    mass: float  # of the robot, relative to its model
    latency_ms: float  # of every node that processes messages


@dataclass(frozen=True, slots=True)
class Recipe:
    """All that a run is a function of; poses and the fake object are in the map frame."""

    mode: str
    scenario: Mapping[str, Any]  # the document
    parameters: Mapping[str, Any]  # a value for each of the scenario's
    conditions: Conditions
    run: int
    block: int
    seed: int
    session: Session
    start: Pose2D
    goals: tuple[Pose2D, ...]
    fake_object: FakeObject
    storage: Storage
    timeout_s: float
    options: Options

    def generator(self, node: str) -> np.random.Generator:
        """Return the randomness of one node; the same in every mode of the block."""
        return node_generator(self.seed, _NODE, self.block, node)

    def attack_seed(self) -> int:
        """Return the key of the attack's own, counter-based randomness."""
        return int(sequence(self.seed, _ATTACK, self.block).generate_state(1, np.uint64)[0])

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON knows it."""
        return {**asdict(self), "goals": [asdict(goal) for goal in self.goals]}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe that ``to_dict`` gave."""
        return cls(
            **{
                **document,
                "conditions": Conditions(**document["conditions"]),
                "session": Session(**document["session"]),
                "start": Pose2D(**document["start"]),
                "goals": tuple(Pose2D(**goal) for goal in document["goals"]),
                "fake_object": FakeObject(**document["fake_object"]),
                "options": Options(**document["options"]),
            }
        )


def draw_session(seed: int, index: int) -> Session:
    """Draw the conditions of a session."""
    rng = generator(seed, _SESSION, index)
    return Session(
        index=index,
        lidar_bias_m=rng.uniform(-0.01, 0.01),
        lidar_noise_m=rng.uniform(0.008, 0.015),
        friction=rng.uniform(0.8, 1.2),
        mass=rng.uniform(0.9, 1.1),
        latency_ms=rng.uniform(1.0, 8.0),
    )


@dataclass(frozen=True, slots=True)
class Block:
    """What the runs of one block share, in the map frame."""

    start: Pose2D
    goals: tuple[Pose2D, ...]
    fake_object: FakeObject


@functools.cache  # all modes of a block share it
def draw_block(seed: int, block: int, goals: int) -> Block:
    """Draw a patrol that can be driven, and a fake object across it.

    Start and goals keep ``MIN_CLEARANCE_M`` from every obstacle, lie ``MIN_LEG_M`` apart, and the
    planner finds a path between them.
    """
    rng = generator(seed, _BLOCK, block)
    grid = planning_grid()
    stops = [_draw_free_pose(rng)]
    legs: list[NDArray[np.float64]] = []
    while len(legs) < goals:
        stop = _draw_free_pose(rng)
        if stop.distance_to(stops[-1]) < MIN_LEG_M:
            continue
        path = plan(grid, (stops[-1].x, stops[-1].y), (stop.x, stop.y))
        if path is not None:
            stops.append(stop)
            legs.append(path)
    return Block(stops[0], tuple(stops[1:]), _draw_fake_object(rng, legs, stops))


def _draw_free_pose(rng: np.random.Generator) -> Pose2D:
    """Draw a pose in the map frame that keeps clear of everything."""
    while True:
        x, y = rng.uniform(-RING.circumradius, RING.circumradius, 2).tolist()
        if clearance(np.array([[x, y]]))[0] >= MIN_CLEARANCE_M:
            return WORLD_IN_MAP.compose(Pose2D(x, y, rng.uniform(-math.pi, math.pi)))


def _draw_fake_object(
    rng: np.random.Generator, legs: list[NDArray[np.float64]], stops: list[Pose2D]
) -> FakeObject:
    """Draw a cylinder across the path of a late leg, where the way around it is a detour.

    It keeps clear of where the robot must start and stop. Where no draw is a detour, the one with
    the longest way around is taken.
    """
    avoid = np.array([(stop.x, stop.y) for stop in stops])
    first = min(_FIRST_LATE_LEG, len(legs) - 1)
    drawn: list[tuple[float, FakeObject]] = []  # how long the way around it is, and the object
    while len(drawn) < _OBJECT_DRAWS and (not drawn or drawn[-1][0] < MIN_DETOUR):
        index = int(rng.integers(first, len(legs)))
        leg = legs[index]
        middle = leg[int(0.3 * len(leg)) : int(0.7 * len(leg)) + 1]
        x, y = (middle[rng.integers(len(middle))] + rng.normal(0.0, 0.05, 2)).tolist()
        there = FakeObject(x, y, radius=rng.uniform(0.15, 0.25))
        is_clear = np.hypot(*(avoid - (x, y)).T).min() >= FAKE_OBJECT_CLEARANCE_M
        detour = _detour(leg, stops[index], stops[index + 1], there) if is_clear else 0.0
        drawn.append((detour, there))
    _, chosen = max(drawn, key=lambda draw: draw[0])
    return chosen


def _detour(leg: NDArray[np.float64], begin: Pose2D, end: Pose2D, obstacle: FakeObject) -> float:
    """Return how many times as long as a leg the way around an obstacle is; 0 if there is none."""
    around = plan(planning_grid(obstacle), (begin.x, begin.y), (end.x, end.y))
    return 0.0 if around is None else path_length(around) / path_length(leg)


def path_length(path: NDArray[np.float64]) -> float:
    """Return the length of a path of shape (n, 2) [m]."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


_INFLATION = InflationLayer(RESOLUTION_M, INSCRIBED_RADIUS, GLOBAL_COST_SCALING)


@functools.cache
def _empty_world() -> Costmap2D:
    world = turtlebot3_world_map()
    costs = static_costs(world.data)
    _INFLATION.add_to(costs)
    return Costmap2D(costs, world.resolution, *world.origin, "map")


def planning_grid(obstacle: FakeObject | None = None) -> Costmap2D:
    """Return the global costmap of the world, empty or with an obstacle in it."""
    empty = _empty_world()
    grid = replace(empty, costs=empty.costs.copy())
    if obstacle is not None:
        rows, columns = (np.arange(cells) + 0.5 for cells in grid.costs.shape)
        x = grid.origin_x + grid.resolution * columns - obstacle.x
        y = grid.origin_y + grid.resolution * rows - obstacle.y
        inside = x**2 + y[:, None] ** 2 <= obstacle.radius**2
        grid.costs[inside] = LETHAL
        _INFLATION.add_to(grid.costs, inside)
    return grid


def recipe_for(
    mode: str | Mode,
    run: int,
    campaign: Campaign,
    parameters: Mapping[str, Any] | None = None,
) -> Recipe | AtcRecipe:
    """Return the recipe of one run of a campaign.

    Parameters
    ----------
    mode
        One of ``modes`` by its name, or any other.
    run, campaign
        Which run, of what.
    parameters
        Values of the scenario's parameters, in place of what the block has drawn or the default.

    Raises
    ------
    RecipeError
        If there is no such mode, or it is an attack and its node is to be absent.
    """
    if isinstance(mode, str):
        if mode not in modes():
            raise RecipeError(f"There is no mode {mode!r}; there are {', '.join(modes())}.")
        mode = modes()[mode]
    given = parameters or {}
    if mode.testbed == "atc":
        skies = AtcCampaign(
            seed=campaign.seed, duration_s=campaign.timeout_s, storage=campaign.storage
        )
        return atc_recipe_for(mode, run, skies, given)
    if campaign.options.wiring == "absent" and mode.label == "malicious":
        raise RecipeError(f"{mode.id} without its node is no attack; take a passthrough mode.")
    block = draw_block(campaign.seed, run, campaign.goals_per_run)
    return Recipe(
        mode=mode.id,
        scenario=mode.scenario.document,
        parameters=mode.parameters(_drawn(block, campaign.options), given),
        conditions=mode.conditions,
        run=run,
        block=run,
        seed=campaign.seed,
        session=draw_session(campaign.seed, run % SESSIONS),
        start=block.start,
        goals=block.goals,
        fake_object=block.fake_object,
        storage=campaign.storage,
        timeout_s=campaign.timeout_s,
        options=campaign.options,
    )


def _drawn(block: Block, options: Options) -> dict[str, float]:
    """Return what scenarios may ask of a block; a node knows the odometry frame only."""
    there = block.fake_object
    odom = odom_in_map(options.odometry_source, block.start)
    seen = odom.inverse().compose(Pose2D(there.x, there.y))
    return {"object_x": seen.x, "object_y": seen.y, "object_radius": there.radius}
