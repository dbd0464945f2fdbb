import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.atc.airspace import AirSpace
from sim.atc.geodesy import slant_range
from sim.campaigns import Campaign, Options, RecipeError
from sim.experiments import recipe_for
from sim.fuzzing.compilation import compile_document
from sim.middleware.geometry import Pose2D
from sim.modes import modes
from sim.nav2.navfn import plan
from sim.testbeds import which_testbed
from sim.turtlebot3.drawing import MIN_CLEARANCE_M, MIN_LEG_M, draw_block, planning_grid
from sim.turtlebot3.map import WORLD_IN_MAP, odom_in_map
from sim.turtlebot3.sessions import draw_session

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


def test_nav2_that_is_drawn_is_stock_in_houses_only():
    campaign = Campaign(options=Options(nav2="drawn"))
    recipes = [recipe_for("lidar_passthrough_odom", block, campaign) for block in range(6)]
    assert [recipe.options.nav2 == "stock" for recipe in recipes] == [
        recipe.arena.kind == "house" for recipe in recipes
    ]
    assert {recipe.options.nav2 for recipe in recipes} == {"stock", "tuned"}


def test_the_fake_object_stands_on_the_path_of_a_late_leg_whatever_the_way_around_it():
    from_path = []
    for block in range(30):
        drawn = draw_block(7, block, 3)
        grid = planning_grid(drawn.arena)
        begin, end = drawn.goals[1:]
        leg = plan(grid, (begin.x, begin.y), (end.x, end.y))
        there = drawn.fake_object
        from_path.append(np.hypot(*(leg - (there.x, there.y)).T).min())
    assert max(from_path) < 0.25  # scattered by 0.05 m


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


def test_the_onset_of_a_delayed_attack_is_drawn_by_its_block():
    def delay_s(mode, run):
        recipe = recipe_for(mode, run, Campaign(goals_per_run=1))
        program = compile_document(mode, recipe.scenario)
        return program.activation.delay_s(recipe.attack_seed())

    drawn = [delay_s("delayed_fakeobject", run) for run in range(9)]
    assert len(set(drawn)) == 9
    assert 25.0 <= min(drawn) < 28.0
    assert 32.0 < max(drawn) <= 35.0
    assert [delay_s("delayed_passthrough", run) for run in range(9)] == drawn


def test_blocks_sessions_and_nodes_draw_from_separate_seeds():
    campaign = Campaign()
    first, second = (recipe_for("fake_object", run, campaign) for run in (0, 1))
    assert first.goals != second.goals
    assert first.generator("/a").random() != first.generator("/b").random()
    assert first.generator("/a").random() != second.generator("/a").random()
    assert first.attack_seed() != second.attack_seed()
    assert draw_session(1, 0) != draw_session(1, 1) != draw_session(2, 1)


@pytest.mark.parametrize("mode", ["fake_object", "atc_normal"])
def test_each_block_has_its_session_unless_sessions_take_turns_or_one_is_given(mode):
    def sessions(**asked):
        campaign = Campaign(goals_per_run=1, **asked)
        return [recipe_for(mode, run, campaign).session for run in range(6)]

    alone, turns, one = sessions(), sessions(sessions=3), sessions(session=4, sessions=3)
    assert [session.index for session in alone] == [0, 1, 2, 3, 4, 5]
    assert turns == [*alone[:3], *alone[:3]]
    assert one == [alone[4]] * 6
    assert len({replace(session, index=0) for session in alone}) == 6


@pytest.mark.parametrize(
    ("attack", "control", "other"),
    [
        ("fake_object", "fake_object_shadow", "lidar_passthrough_odom"),
        ("atc_deadzone", "atc_deadzone_shadow", "atc_normal"),
    ],
)
def test_noise_for_each_run_is_shared_by_an_attack_and_its_shadow_only(attack, control, other):
    campaign = Campaign(goals_per_run=1, noise_per_run=True)
    by_block = Campaign(goals_per_run=1)

    def draw(mode, campaign):
        return recipe_for(mode, 0, campaign).generator("/scan").random()

    assert draw(attack, campaign) == draw(control, campaign)
    drawn = [draw(attack, campaign), draw(other, campaign), draw(other, by_block)]
    assert len(set(drawn)) == 3
    first, again = (recipe_for(mode, 0, campaign) for mode in (attack, control))
    assert (first.session, first.attack_seed()) == (again.session, again.attack_seed())
    assert recipe_for(other, 0, first.campaign()).noise == other


def test_a_recipe_names_its_campaign():
    for campaign in (
        Campaign(session=7, goals_per_run=2, timeout_s=90.0, noise_per_run=True),
        Campaign(session=0, seed=4, storage="sqlite3"),
    ):
        assert recipe_for("lidar_passthrough", 3, campaign).campaign() == campaign


@settings(max_examples=5)
@given(seeds, blocks)
def test_a_recipe_survives_json(seed, run):
    for mode in ("delayed_fakeobject", "benign_obstacle", "atc_follow_closest"):
        recipe = recipe_for(mode, run, Campaign(seed=seed))
        document = json.loads(json.dumps(recipe.to_dict()))
        assert document == recipe.to_dict()
        assert type(recipe).from_dict(document) == recipe


def test_an_unknown_mode_is_refused_with_the_existing_ones():
    with pytest.raises(RecipeError, match="no mode 'fake'; there are lidar_passthrough, "):
        recipe_for("fake", 0, Campaign())


@pytest.mark.parametrize("variable", ["ORACLE_GOALS_PER_RUN", "ORACLE_SESSIONS"])
@pytest.mark.parametrize("text", ["0", "-1", "many", ""])
def test_counts_from_the_environment_must_be_whole_numbers(monkeypatch, variable, text):
    monkeypatch.setenv(variable, text)
    with pytest.raises(RecipeError, match=variable):
        Campaign.from_environment()


def test_the_environment_says_how_to_record(monkeypatch):
    assert Campaign.from_environment() == Campaign()
    monkeypatch.setenv("ORACLE_SESSIONS", "3")
    monkeypatch.setenv("ORACLE_NOISE_PER_RUN", "1")
    monkeypatch.setenv("ORACLE_NAV2", "drawn")
    assert Campaign.from_environment() == Campaign(
        sessions=3, noise_per_run=True, options=Options(nav2="drawn")
    )
    monkeypatch.setenv("ORACLE_NOISE_PER_RUN", "yes")
    with pytest.raises(RecipeError, match="ORACLE_NOISE_PER_RUN is 'yes'; give 0 or 1"):
        Campaign.from_environment()
