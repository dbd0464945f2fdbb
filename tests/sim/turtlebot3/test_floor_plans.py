"""Arenas that are drawn: a robot gets everywhere, and their maps show all pieces."""

import json
import math
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sim.campaigns import Campaign, Options
from sim.experiments import recipe_for
from sim.nav2.navfn import plan
from sim.testbed import from_json
from sim.turtlebot3.arena import Arena, Box
from sim.turtlebot3.drawing import MIN_CLEARANCE_M, planning_grid
from sim.turtlebot3.floor_plans import KINDS, draw_arena
from sim.turtlebot3.map import FREE, OCCUPIED, RESOLUTION_M, WORLD_IN_MAP, occupancy_map
from sim.turtlebot3.mjcf import WorldParameters, mjcf

NARROWEST_M = 0.85  # doors and passages are 0.9 m wide at least; cells cost up to one of 0.05 m
MOST_GEOMS = 40
LARGEST_M = 8.0  # a side

arenas = st.builds(draw_arena, st.sampled_from(["house", "random"]), st.integers(0, 2**32 - 1))


def distances(arena):
    """The map, and of each of its cells' centres the distance to the nearest surface."""
    world = occupancy_map(arena)
    rows, columns = np.indices(world.data.shape)
    centres = RESOLUTION_M * (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5)
    in_world = WORLD_IN_MAP.inverse().apply(centres + world.origin)
    return world, arena.clearance(in_world).reshape(world.data.shape)


@given(st.sampled_from(KINDS), st.integers(0, 2**32 - 1))
def test_an_arena_is_a_function_of_its_seed_and_survives_json(kind, seed):
    arena = draw_arena(kind, seed)
    assert draw_arena(kind, seed) == arena
    document = json.loads(json.dumps(asdict(arena)))
    assert from_json(Arena, document) == arena


@given(st.sampled_from(["house", "random"]), st.integers(0, 2**32 - 2))
def test_arenas_of_different_seeds_differ(kind, seed):
    one, other = draw_arena(kind, seed), draw_arena(kind, seed + 1)
    assert (one.blocks, one.pillars) != (other.blocks, other.pillars)
    assert one.id != other.id


@given(arenas)
def test_arenas_are_bounded(arena):
    assert 2.0 * max(arena.boundary.reach) < LARGEST_M
    assert mjcf(WorldParameters(None, arena=arena)).count('group="0"') <= MOST_GEOMS
    names = [piece.name for piece in (arena.boundary, *arena.blocks, *arena.pillars)]
    assert len(set(names)) == len(names)


@settings(max_examples=20)
@given(arenas)
def test_wherever_a_robot_may_stop_it_gets_through_wide_passages(arena):
    _, distance = distances(arena)
    pieces, count = ndimage.label(distance >= NARROWEST_M / 2.0)
    stops = set(pieces[distance >= MIN_CLEARANCE_M].tolist())
    assert len(stops) == 1 <= count
    assert (distance >= MIN_CLEARANCE_M).sum() * RESOLUTION_M**2 > 4.0, "there is room to stop"


@settings(max_examples=8)
@given(arenas)
def test_the_planner_gets_from_each_corner_of_the_free_space_to_every_other(arena):
    world, distance = distances(arena)
    rows, columns = np.nonzero(distance >= MIN_CLEARANCE_M)
    far = [int(np.argmin(i * rows + j * columns)) for i in (-1, 1) for j in (-1, 1)]
    stops = [
        tuple(
            o + RESOLUTION_M * (c[n] + 0.5)
            for o, c in zip(world.origin, (columns, rows), strict=True)
        )
        for n in far
    ]
    grid = planning_grid(arena)
    assert all(plan(grid, begin, end) is not None for begin, end in pairwise([*stops, stops[0]]))


@given(st.integers(0, 2**32 - 1))
def test_every_door_is_a_gap_of_at_least_0_9_m_between_two_parts_of_a_wall(seed):
    doors = 0
    for arena in (draw_arena("house", seed), draw_arena("random", seed)):
        parts = {b.name: b for b in arena.blocks if isinstance(b, Box)}
        for name, part in parts.items():
            wall, _, number = name.rpartition("_")
            beside = parts.get(f"{wall}_{int(number) + 1}")
            if wall.startswith(("wall", "middle", "left", "right")) and beside is not None:
                gap = max(
                    beside.x - part.x - beside.half_x - part.half_x,
                    beside.y - part.y - beside.half_y - part.half_y,
                )
                assert gap >= 0.9
                doors += 1
    assert doors >= 4, "the house has them"


@settings(max_examples=20)
@given(arenas)
def test_the_map_is_the_geometry(arena):
    world, distance = distances(arena)
    known = (world.data == FREE) | (world.data == OCCUPIED)
    assert np.abs(distance[world.data == OCCUPIED]).max() < 0.07
    assert (distance[world.data == FREE] > 0.0).all()
    assert (world.data[(distance > 0.0) & (distance < 0.025)] == OCCUPIED).all()
    assert (known == (distance > 0.0) | (world.data == OCCUPIED)).all()
    beside = ndimage.binary_dilation(world.data == FREE) & (world.data != FREE)
    assert set(world.data[beside].tolist()) == {OCCUPIED}
    edge = np.ones_like(known)
    edge[1:-1, 1:-1] = False
    assert not known[edge].any()


@given(
    st.floats(-4, 4), st.floats(-4, 4), st.floats(0.1, 2), st.floats(0.1, 2),
    st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_distance_to_a_box_is_that_to_its_nearest_side(x, y, half_x, half_y, yaw):
    box = Box("box", 0.5, -0.3, half_x, half_y, yaw)
    share = np.linspace(-1.0, 1.0, 801)
    ends = np.ones_like(share)
    sides = np.concatenate(
        [np.column_stack([share * half_x, s * ends * half_y]) for s in (-1, 1)]
        + [np.column_stack([s * ends * half_x, share * half_y]) for s in (-1, 1)]
    )
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    nearest = np.hypot(*(sides @ turn.T + (0.5, -0.3) - (x, y)).T).min()
    found = box.signed_distance(np.array([[x, y]]))[0]
    assert abs(found) == pytest.approx(nearest, abs=6e-3)


def test_arenas_take_turns_by_block_unless_one_is_chosen():
    def kinds(choice):
        campaign = Campaign(goals_per_run=1, options=Options(arena=choice))
        return [recipe_for("lidar_passthrough", run, campaign).arena.kind for run in range(6)]

    assert kinds("drawn") == [*KINDS, *KINDS]
    assert all(kinds(kind) == 6 * [kind] for kind in KINDS)


def test_sixty_blocks_hold_forty_worlds_that_stand_in_no_other_block():
    ids = [
        recipe_for("lidar_passthrough", run, Campaign(goals_per_run=1)).arena.id
        for run in range(60)
    ]
    assert len(set(ids)) == 41
    assert ids.count("hexagon-0") == 20


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_patrol_of_one_goal_succeeds_in_an_arena_of_each_kind(kind, recorded_run):
    run = recorded_run(
        "lidar_passthrough_odom", 1, Campaign(goals_per_run=1, options=Options(arena=kind))
    )
    manifest = run.manifest()
    assert manifest.world == from_json(Arena, manifest.recipe["arena"]).id
    assert manifest.world.startswith(kind)
    assert (manifest.outcome, manifest.contacts) == ("succeeded", ())


@pytest.mark.slow
def test_with_stock_settings_the_collision_monitor_acts_in_a_door_and_the_patrol_succeeds(
    recorded_run,
):
    def drive(nav2):
        options = Options(arena="house", nav2=nav2)
        run = recorded_run("lidar_passthrough_odom", 10, Campaign(goals_per_run=1, options=options))
        manifest = run.manifest()
        assert manifest.outcome == "succeeded"
        return manifest.drive.commands_altered / manifest.drive.commands

    assert drive("stock") > drive("tuned")
