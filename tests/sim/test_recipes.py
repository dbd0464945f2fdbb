import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.modes import PAIRS, modes
from sim.recipes import (
    MIN_CLEARANCE_M,
    MIN_LEG_M,
    Campaign,
    Recipe,
    RecipeError,
    draw_session,
    recipe_for,
)
from sim.turtlebot3.arena import RING, clearance
from sim.turtlebot3.map import WORLD_IN_MAP

blocks = st.integers(0, 200)
seeds = st.integers(0, 2**32)


def in_world(poses):
    return WORLD_IN_MAP.inverse().apply(np.array([(pose.x, pose.y) for pose in poses]))


@settings(max_examples=20)
@given(seeds, blocks, st.integers(1, 8))
def test_start_and_goals_are_clear_of_obstacles_inside_the_ring_and_apart(seed, run, goals):
    recipe = recipe_for("fake_object", run, Campaign(seed=seed, goals_per_run=goals))
    stops = [recipe.start, *recipe.goals]
    assert len(recipe.goals) == goals
    assert (clearance(in_world(stops)) >= MIN_CLEARANCE_M - 1e-9).all()
    assert (RING.signed_distance(in_world(stops)) < 0.0).all()
    assert all(a.distance_to(b) >= MIN_LEG_M for a, b in pairwise(stops))


@settings(max_examples=20)
@given(seeds, blocks)
def test_the_fake_object_leaves_start_and_goals_free(seed, run):
    recipe = recipe_for("fake_object", run, Campaign(seed=seed))
    target = recipe.fake_object
    distances = np.hypot(*(in_world([recipe.start, *recipe.goals]) - (target.x, target.y)).T)
    assert distances.min() > target.radius + 0.25


@settings(max_examples=10)
@given(seeds, blocks)
def test_runs_of_one_block_differ_in_their_mode_only(seed, run):
    campaign = Campaign(seed=seed)
    recipes = [recipe_for(mode, run, campaign) for mode in modes()]
    assert {replace(recipe, mode="any") for recipe in recipes} == {replace(recipes[0], mode="any")}
    draws = {recipe.generator("/scan").random() for recipe in recipes}
    assert len(draws) == 1


def test_blocks_sessions_and_nodes_draw_from_seeds_of_their_own():
    campaign = Campaign()
    first, second = (recipe_for("fake_object", run, campaign) for run in (0, 1))
    assert first.goals != second.goals
    assert first.generator("/a").random() != first.generator("/b").random()
    assert first.generator("/a").random() != second.generator("/a").random()
    assert first.attack_seed() != second.attack_seed()
    assert draw_session(1, 0) != draw_session(1, 1) != draw_session(2, 1)


def test_three_sessions_take_turns():
    sessions = [
        recipe_for("fake_object", run, Campaign(goals_per_run=1)).session for run in range(6)
    ]
    assert [session.index for session in sessions] == [0, 1, 2, 0, 1, 2]
    assert sessions[:3] == sessions[3:]


@settings(max_examples=10)
@given(seeds, blocks)
def test_a_recipe_survives_json(seed, run):
    recipe = recipe_for("delayed_fakeobject", run, Campaign(seed=seed))
    assert Recipe.from_dict(json.loads(json.dumps(recipe.to_dict()))) == recipe


def test_an_unknown_mode_is_refused_with_those_that_there_are():
    with pytest.raises(RecipeError, match="no mode 'fake'; there are lidar_passthrough, "):
        recipe_for("fake", 0, Campaign())


@pytest.mark.parametrize("text", ["0", "-1", "many", ""])
def test_goals_per_run_from_the_environment_must_be_a_whole_number(monkeypatch, text):
    monkeypatch.setenv("ORACLE_GOALS_PER_RUN", text)
    with pytest.raises(RecipeError, match="ORACLE_GOALS_PER_RUN"):
        Campaign.from_environment()


def test_pairs_are_a_normal_and_a_malicious_mode():
    known = modes()
    assert [(known[a].label, known[b].label) for a, b in PAIRS] == [("normal", "malicious")] * 3
    assert list(known)[:6] == [
        "lidar_passthrough", "lidar_passthrough_odom", "fake_object", "random_noise",
        "delayed_passthrough", "delayed_fakeobject",
    ]  # fmt: skip
