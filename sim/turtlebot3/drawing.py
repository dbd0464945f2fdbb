"""Draws a run on the TurtleBot3 testbed from the campaign's seed.

Run i of every mode belongs to block i, with the same arena, start, goals, fake object and session.
So a mode and its control differ only in the mode, and in noise if the campaign draws it for each
run.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats
from sim.campaigns import ArenaChoice, Campaign, Navigation, Options, RecipeError, Relation
from sim.middleware.geometry import Pose2D
from sim.nav2.costmap import Costmap2D
from sim.nav2.costmap_layers import static_costs
from sim.nav2.dwb_sampling import Parameters
from sim.nav2.footprint import INSCRIBED_RADIUS
from sim.nav2.inflation import GLOBAL_COST_SCALING, Inflation, InflationLayer
from sim.nav2.navfn import plan
from sim.seeds import BLOCK, generator, sequence
from sim.testbed import Mode
from sim.turtlebot3.arena import Arena
from sim.turtlebot3.floor_plans import KINDS, draw_arena
from sim.turtlebot3.map import RESOLUTION_M, WORLD_IN_MAP, occupancy_map, odom_in_map
from sim.turtlebot3.recipes import ARENA, RELATION, Block, Conditions, FakeObject, TurtleBot3Recipe
from sim.turtlebot3.relations import related
from sim.turtlebot3.sessions import draw_session

MIN_CLEARANCE_M = 0.55  # of start and goals from every obstacle; see docs/explanation/navigation.md
MIN_LEG_M = 1.5  # straight distance from one goal to the next
# By how much, for each metre driven, a path must come nearer to the end of the part that the
# controller sees, measured along the axes. DWB measures that distance through walls. Where a path
# first leads away, as in a turn around the end of a wall, the robot does not move.
MIN_APPROACH = 0.2
_SEEN_M = 1.5  # half a side of the local costmap
_FOLLOWED_M = Parameters().forward_prune_distance
_LOOK_AHEAD_M = 0.3
FAKE_OBJECT_CLEARANCE_M = 0.6  # of the fake object from start and goals
_FIRST_LATE_LEG = 2  # a delayed attack begins on the second or third leg


@functools.cache  # all modes of a block share it
def draw_block(seed: int, block: int, goals: int, choice: ArenaChoice = "drawn") -> Block:
    """Draw an arena, a patrol that can be driven in it, and a fake object across it.

    Start and goals keep ``MIN_CLEARANCE_M`` from every obstacle, lie ``MIN_LEG_M`` apart, and the
    planner finds a path between them that the controller can follow.
    """
    kind = KINDS[block % len(KINDS)] if choice == "drawn" else choice
    arena = draw_arena(kind, int(sequence(seed, ARENA, block).generate_state(1)[0]))
    rng = generator(seed, BLOCK, block)
    grid = planning_grid(arena)
    stops = [_draw_free_pose(rng, arena)]
    legs: list[Floats] = []
    while len(legs) < goals:
        stop = _draw_free_pose(rng, arena)
        if stop.distance_to(stops[-1]) < MIN_LEG_M:
            continue
        path = plan(grid, (stops[-1].x, stops[-1].y), (stop.x, stop.y))
        if path is not None and _can_be_followed(path):
            stops.append(stop)
            legs.append(path)
    return Block(arena, stops[0], tuple(stops[1:]), _draw_fake_object(rng, legs, stops))


def _in_relation(seed: int, run: int, drawn: Block, relation: Relation) -> Block:
    """Return the first block in a relation to a drawn one whose patrol can be driven."""
    if relation == "same":
        return drawn
    for block in related(drawn, relation, generator(seed, RELATION, run)):
        stops = [block.start, *block.goals]
        is_clear = block.arena.clearance(
            WORLD_IN_MAP.inverse().apply(np.array([(stop.x, stop.y) for stop in stops]))
        )
        if (is_clear >= MIN_CLEARANCE_M - 1e-9).all() and all(
            path is not None and _can_be_followed(path)
            for path in (
                plan(planning_grid(block.arena), (a.x, a.y), (b.x, b.y)) for a, b in pairwise(stops)
            )
        ):
            return block
    raise RecipeError(f"The patrol of block {run} cannot be driven {relation}; take other blocks.")


def _nav2(arena: Arena, options: Options) -> Navigation:
    if options.nav2 != "drawn":
        return options.nav2
    return "stock" if arena.kind == "house" else "tuned"


@jit
def _can_be_followed(path: Floats) -> bool:
    """Return whether the controller can follow a path of shape (n, 2) in the map frame.

    See `MIN_APPROACH`.
    """
    driven = np.zeros(len(path))
    for i in range(1, len(path)):
        step = math.hypot(path[i, 0] - path[i - 1, 0], path[i, 1] - path[i - 1, 1])
        driven[i] = driven[i - 1] + step
    for i in range(0, len(path), 4):
        end = i  # of what the controller sees
        while end < len(path) - 1:
            away = math.hypot(path[end, 0] - path[i, 0], path[end, 1] - path[i, 1])
            if away > _SEEN_M or driven[end] - driven[i] > _FOLLOWED_M:
                break
            end += 1
        ahead = i
        while ahead < len(path) and driven[ahead] - driven[i] < _LOOK_AHEAD_M:
            ahead += 1
        if ahead >= end:
            return True  # the goal is near
        left = abs(path[end, 0] - path[i, 0]) + abs(path[end, 1] - path[i, 1])
        left_ahead = abs(path[end, 0] - path[ahead, 0]) + abs(path[end, 1] - path[ahead, 1])
        if left - left_ahead < MIN_APPROACH * (driven[ahead] - driven[i]):
            return False
    return True


def _draw_free_pose(rng: np.random.Generator, arena: Arena) -> Pose2D:
    """Draw a pose in the map frame that is clear of all obstacles."""
    reach = max(arena.boundary.reach)
    while True:
        x, y = rng.uniform(-reach, reach, 2).tolist()
        if arena.clearance(np.array([[x, y]]))[0] >= MIN_CLEARANCE_M:
            return WORLD_IN_MAP.compose(Pose2D(x, y, rng.uniform(-math.pi, math.pi)))


def _draw_fake_object(
    rng: np.random.Generator, legs: list[Floats], stops: list[Pose2D]
) -> FakeObject:
    """Draw a cylinder on the path of a late leg, even if it blocks every way around.

    It is clear of the poses where the robot must start and stop. If the legs leave no such place,
    it is as far from those poses as they allow.
    """
    late = legs[min(_FIRST_LATE_LEG, len(legs) - 1) :]
    on_path = np.concatenate([leg[int(0.3 * len(leg)) : int(0.7 * len(leg)) + 1] for leg in late])
    avoid = np.array([(stop.x, stop.y) for stop in stops])
    nearest = np.hypot(*(on_path[:, None] - avoid).T).min(axis=0)
    is_clear = nearest >= min(FAKE_OBJECT_CLEARANCE_M, nearest.max())
    x, y = (rng.choice(on_path[is_clear]) + rng.normal(0.0, 0.05, 2)).tolist()
    return FakeObject(x, y, radius=rng.uniform(0.15, 0.25))


def path_length(path: Floats) -> float:
    """Return the length of a path of shape (n, 2) [m]."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


@functools.lru_cache(maxsize=8)  # see `occupancy_map`
def planning_grid(arena: Arena) -> Costmap2D:
    """Return the global costmap of an arena, without obstacles that are on no map."""
    world = occupancy_map(arena)
    costs = static_costs(world.data)
    InflationLayer(
        RESOLUTION_M, INSCRIBED_RADIUS, Inflation(cost_scaling=GLOBAL_COST_SCALING)
    ).add_to(costs)
    return Costmap2D(costs, world.resolution, *world.origin, "map")


def draw(
    mode: Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any]
) -> TurtleBot3Recipe:
    """Return the recipe of one run of a campaign.

    Parameters
    ----------
    mode, run, campaign
        Mode, number and campaign of the run.
    parameters
        Values of the scenario's parameters, in place of those drawn for the block or the defaults.

    Raises
    ------
    RecipeError
        If the mode is an attack and its node is to be absent, or the patrol cannot be driven in
        the requested relation.
    """
    absent = campaign.options.wiring == "absent" and not mode.scenario.is_in_place
    if absent and mode.label == "malicious":
        raise RecipeError(f"{mode.id} without its node is no attack; take a passthrough mode.")
    drawn = draw_block(campaign.seed, run, campaign.goals_per_run, campaign.options.arena)
    block = _in_relation(campaign.seed, run, drawn, campaign.options.relation)
    return TurtleBot3Recipe(
        **mode.recipe_fields(run, campaign, _drawn(block, campaign.options), parameters),
        conditions=Conditions(**mode.conditions),
        session=draw_session(campaign.seed, campaign.session_of(run)), arena=block.arena,
        start=block.start, goals=block.goals, fake_object=block.fake_object,
        timeout_s=campaign.timeout_s,
        options=replace(campaign.options, nav2=_nav2(block.arena, campaign.options)),
    )  # fmt: skip


def _drawn(block: Block, options: Options) -> dict[str, float]:
    """Return the properties of a block that scenarios may use, in the odometry frame."""
    there = block.fake_object
    odom = odom_in_map(options.odometry_source, block.start)
    seen = odom.inverse().compose(Pose2D(there.x, there.y))
    return {"object_x": seen.x, "object_y": seen.y, "object_radius": there.radius}
