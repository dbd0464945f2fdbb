"""Metamorphic relations: how the correct behaviour changes with the task."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.campaigns import Campaign, Options
from sim.experiments import recipe_for
from sim.nav2.navfn import plan
from sim.turtlebot3.arena import HEXAGON
from sim.turtlebot3.drawing import path_length, planning_grid
from sim.turtlebot3.floor_plans import draw_arena
from sim.turtlebot3.map import WORLD_IN_MAP
from sim.turtlebot3.relations import SHIFT_M
from tests.recorded_runs import ONE_GOAL

blocks = st.integers(0, 60)


def recipe(block, relation, goals=2):
    campaign = Campaign(goals_per_run=goals, options=Options(relation=relation))
    return recipe_for("lidar_passthrough_odom", block, campaign)


def way_m(recipe):
    grid = planning_grid(recipe.arena)
    stops = [recipe.start, *recipe.goals]
    return sum(path_length(plan(grid, (a.x, a.y), (b.x, b.y))) for a, b in pairwise(stops))


@given(st.sampled_from(["hexagon", "house", "random"]), st.integers(0, 99))
@settings(max_examples=10)
def test_a_mirrored_arena_is_as_far_from_everything_at_the_mirrored_place(kind, seed):
    arena = draw_arena(kind, seed)
    places = np.random.default_rng(seed).uniform(-4.0, 4.0, (200, 2))
    there = arena.mirrored().clearance(places * (1.0, -1.0))
    assert there == pytest.approx(arena.clearance(places), abs=1e-9)
    assert arena.mirrored().mirrored() == arena


def test_the_hexagon_is_its_own_mirror_image():
    places = np.random.default_rng(0).uniform(-3.0, 3.0, (200, 2))
    assert HEXAGON.mirrored().clearance(places) == pytest.approx(HEXAGON.clearance(places))


@settings(max_examples=6, deadline=None)
@given(blocks)
def test_in_a_mirrored_world_the_planned_way_is_as_long(block):
    same, mirrored = recipe(block, "same"), recipe(block, "mirrored")
    for ours, theirs in zip(
        (same.start, *same.goals), (mirrored.start, *mirrored.goals), strict=True
    ):
        here, there = (WORLD_IN_MAP.inverse().compose(pose) for pose in (ours, theirs))
        assert (there.x, there.y) == pytest.approx((here.x, -here.y))
        assert math.cos(there.yaw + here.yaw) == pytest.approx(1.0)
    assert way_m(mirrored) == pytest.approx(way_m(same), abs=0.3)  # the cells lie otherwise


@settings(max_examples=6, deadline=None)
@given(st.sampled_from([0, 1, 2, 4, 5]))
def test_in_reverse_order_the_legs_are_the_same(block):
    same, reordered = recipe(block, "same"), recipe(block, "reordered")
    assert [reordered.start, *reordered.goals] == [*reversed(same.goals), same.start]
    assert way_m(reordered) == pytest.approx(way_m(same), abs=0.3)


@settings(max_examples=6, deadline=None)
@given(blocks)
def test_a_shifted_start_is_close_by_and_all_else_is_as_it_was(block):
    same, shifted = recipe(block, "same"), recipe(block, "shifted")
    assert SHIFT_M[0] <= same.start.distance_to(shifted.start) <= SHIFT_M[1]
    assert shifted.start.yaw == same.start.yaw
    for_all = {"start": same.start, "options": same.options}
    assert replace(shifted, **for_all) == same


@pytest.mark.slow
def test_a_robot_drives_the_mirrored_way_in_a_mirrored_world(recorded_run):
    same, mirrored = (
        recorded_run(
            "lidar_passthrough_odom", 0, replace(ONE_GOAL, options=Options(relation=relation))
        ).manifest()
        for relation in ("same", "mirrored")
    )
    assert [each.outcome for each in (same, mirrored)] == ["succeeded"] * 2
    ours, theirs = same.goal_results[0], mirrored.goal_results[0]
    assert theirs.driven_m == pytest.approx(ours.driven_m, rel=0.1)
    assert theirs.ended_s == pytest.approx(ours.ended_s, rel=0.2)
