import json
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.atc.airspace import AirSpace
from sim.atc.geodesy import slant_range
from sim.campaigns import Campaign, Options, RecipeError
from sim.experiments import recipe_for
from sim.middleware.geometry import Pose2D
from sim.modes import modes
from sim.testbeds import which_testbed
from sim.turtlebot3.drawing import MIN_CLEARANCE_M, MIN_LEG_M, draw_session
from sim.turtlebot3.map import WORLD_IN_MAP, odom_in_map

blocks = st.integers(0, 200)
seeds = st.integers(0, 2**32)


def in_world(poses):
    return WORLD_IN_MAP.inverse().apply(np.array([(pose.x, pose.y) for pose in poses]))


@pytest.mark.slow
@settings(max_examples=20)
@given(seeds, blocks, st.integers(1, 8))
def test_start_and_goals_are_clear_of_obstacles_inside_the_arena_and_apart(seed, run, goals):
    recipe = recipe_for("fake_object", run, Campaign(seed=seed, goals_per_run=goals))
    stops = [recipe.start, *recipe.goals]
    assert len(recipe.goals) == goals
    assert (recipe.arena.clearance(in_world(stops)) >= MIN_CLEARANCE_M - 1e-9).all()
    assert (recipe.arena.boundary.signed_distance(in_world(stops)) < 0.0).all()
    assert all(a.distance_to(b) >= MIN_LEG_M for a, b in pairwise(stops))


@pytest.mark.slow
@settings(max_examples=20)
@given(seeds, blocks)
def test_the_fake_object_leaves_start_and_goals_free(seed, run):
    recipe = recipe_for("fake_object", run, Campaign(seed=seed))
    target = recipe.fake_object
    distances = np.hypot(*(in_world([recipe.start, *recipe.goals]) - (target.x, target.y)).T)
    assert distances.min() > target.radius + 0.25


@settings(max_examples=5)
@given(seeds, blocks, st.sampled_from(["turtlebot3", "atc"]))
def test_runs_of_one_block_differ_in_what_their_mode_is_only(seed, run, testbed):
    campaign = Campaign(seed=seed)
    of_testbed = [mode for mode in modes().values() if which_testbed(mode.scenario) == testbed]
    recipes = [recipe_for(mode, run, campaign) for mode in of_testbed]
    assert [recipe.scenario["id"] for recipe in recipes] == [mode.id for mode in of_testbed]
    what = ("mode", "scenario", "parameters", "conditions")
    rest = [
        {key: value for key, value in recipe.to_dict().items() if key not in what}
        for recipe in recipes
    ]
    assert rest == [rest[0]] * len(rest)
    assert len({recipe.generator("/scan").random() for recipe in recipes}) == 1
    assert len({recipe.attack_seed() for recipe in recipes}) == 1


def test_the_fake_object_of_a_block_is_the_attacks_parameter_in_the_odometry_frame():
    for source in ("world", "encoder"):
        campaign = Campaign(options=Options(odometry_source=source))
        recipe = recipe_for("fake_object", 3, campaign)
        values, there = recipe.parameters, recipe.fake_object
        seen = odom_in_map(source, recipe.start).compose(Pose2D(values["x"], values["y"]))
        assert (seen.x, seen.y) == pytest.approx((there.x, there.y))
        assert values["radius"] == there.radius
        assert recipe_for("fake_object_shadow", 3, campaign).parameters == values
        assert recipe_for("lidar_passthrough_odom", 3, campaign).parameters == {}


def test_a_value_that_is_given_goes_before_the_blocks_and_before_the_default():
    drawn = recipe_for("fake_object", 0, Campaign())
    given = recipe_for("fake_object", 0, Campaign(), {"radius": 0.5})
    assert given.parameters == {**drawn.parameters, "radius": 0.5}
    assert recipe_for("random_noise", 0, Campaign()).parameters == {"level": 0.1}
    assert recipe_for("random_noise", 0, Campaign(), {"level": 0.2}).parameters == {"level": 0.2}


def test_the_target_of_air_traffic_attacks_flies_in_coverage_all_the_first_half():
    for run in range(5):
        recipe = recipe_for("atc_delete_by_id", run, Campaign())
        air = AirSpace(recipe.flights, recipe.session.wind)
        (target,) = [n for n, flight in enumerate(recipe.flights)
                     if flight.icao24 == recipe.parameters["target"]]  # fmt: skip
        by_callsign = recipe_for("atc_delete_timer_callsign", run, Campaign()).parameters
        assert by_callsign["callsign"] == recipe.flights[target].callsign
        for second in range(20, 310, 10):
            air.advance_to(second * 1_000_000_000)
            state = air.state(target)
            assert slant_range(math.hypot(state.x, state.y), state.altitude_m) < 111_120.0


def test_targets_differ_between_blocks():
    targets = {
        recipe_for("atc_delete_by_id", run, Campaign()).parameters["target"] for run in range(8)
    }
    assert len(targets) > 2


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


@settings(max_examples=5)
@given(seeds, blocks)
def test_a_recipe_survives_json(seed, run):
    for mode in ("delayed_fakeobject", "benign_obstacle", "atc_follow_closest"):
        recipe = recipe_for(mode, run, Campaign(seed=seed))
        document = json.loads(json.dumps(recipe.to_dict()))
        assert document == recipe.to_dict()
        assert type(recipe).from_dict(document) == recipe


def test_an_unknown_mode_is_refused_with_those_that_there_are():
    with pytest.raises(RecipeError, match="no mode 'fake'; there are lidar_passthrough, "):
        recipe_for("fake", 0, Campaign())


@pytest.mark.parametrize("text", ["0", "-1", "many", ""])
def test_goals_per_run_from_the_environment_must_be_a_whole_number(monkeypatch, text):
    monkeypatch.setenv("ORACLE_GOALS_PER_RUN", text)
    with pytest.raises(RecipeError, match="ORACLE_GOALS_PER_RUN"):
        Campaign.from_environment()
