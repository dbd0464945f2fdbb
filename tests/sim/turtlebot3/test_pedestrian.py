"""A person walks to and fro, is seen by every range sensor, and never walks into the robot."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.campaigns import Campaign
from sim.experiments import recipe_for
from sim.middleware.geometry import Pose2D
from sim.turtlebot3.arena import Cylinder
from sim.turtlebot3.floor_plans import draw_arena
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.pedestrian import PERSON, Pedestrian, Walk, draw_walk
from sim.turtlebot3.world import World

STEP_NS = 20_000_000
WALK = Walk((-2.0, 1.25), (-2.0, 0.25), speed=0.5, stay_s=4.0)
coordinates = st.floats(-3.0, 3.0)


@given(steps=st.lists(st.tuples(coordinates, coordinates), min_size=50, max_size=200))
def test_never_walks_towards_a_robot_that_is_near(steps: list[tuple[float, float]]) -> None:
    person = Pedestrian(WALK)
    for number, robot in enumerate(steps, 1):
        before = math.dist(person.position, robot)
        person.walk_until(number * STEP_NS, Pose2D(*robot))
        after = math.dist(person.position, robot)
        assert after >= min(before, 0.55)


def test_walks_between_the_ends_of_the_walk_and_stays_there() -> None:
    person = Pedestrian(WALK)
    away = Pose2D(100.0, 100.0)
    places = []
    for number in range(1, 2_000):  # 40 s: six ways of 2 s, and seven stays of 4 s
        person.walk_until(number * STEP_NS, away)
        places.append(person.position)
    y = np.array(places)[:, 1]
    assert (y.min(), y.max()) == (0.25, 1.25)
    resting = np.isin(y, (0.25, 1.25)).mean()
    assert resting == pytest.approx(0.7, abs=0.01)


@given(seed=st.integers(0, 999), x=coordinates, y=coordinates)
def test_a_drawn_walk_keeps_clear_of_the_arena(seed: int, x: float, y: float) -> None:
    arena = draw_arena("random", seed % 3)
    if arena.clearance(np.array([[x, y]]))[0] < PERSON.radius:
        return
    walk = draw_walk(np.random.default_rng(seed), arena, Pose2D(), x, y)
    line = np.linspace(walk.start, walk.end, 60)
    assert arena.clearance(line).min() > PERSON.radius - 0.03
    assert math.dist(walk.start, (0, 0)) >= math.dist(walk.end, (0, 0))


@pytest.mark.parametrize("height", [0.1, 0.182, 0.3, PERSON.height - 0.01])
def test_rays_at_every_height_of_a_person_end_where_the_person_is(height: float) -> None:
    world = World(WorldParameters(Pose2D(-2.0, -0.5), walk=WALK))
    person = Pedestrian(WALK)
    bearings = np.linspace(-math.pi, math.pi, 360)
    seen = []
    for time_ns in (1_000_000_000, 5_000_000_000):
        for step_ns in range(world.time_ns, time_ns, STEP_NS):
            world.advance_to(step_ns)
            person.walk_until(step_ns, world.pose)
        pillar = Cylinder("pillar", *person.position, PERSON.radius, PERSON.height)
        still = World(WorldParameters(Pose2D(-2.0, -0.5), obstacles=(pillar,)))
        ranges = world.scan(Pose2D(), height, bearings, 4.0)
        assert ranges == pytest.approx(still.scan(Pose2D(), height, bearings, 4.0), abs=1e-3)
        seen.append(ranges)
    assert not np.array_equal(seen[0], seen[1])


def test_a_robot_that_drives_into_a_person_touches_the_person() -> None:
    corner = Walk((-1.4, -0.5), (-1.4, -0.5), speed=0.5, stay_s=1.0)  # nowhere to go
    world = World(WorldParameters(Pose2D(-2.0, -0.5), walk=corner))
    world.command_wheels(6.0, 6.0)  # 0.2 m/s
    for time_ns in range(0, 4_000_000_000, STEP_NS):
        world.advance_to(time_ns)
    assert [touch.piece for touch in world.touches][:1] == [PERSON.name]
    assert world.pose.x < -1.4 - PERSON.radius + 0.05


def test_only_the_recipe_of_a_pedestrian_names_one() -> None:
    campaign = Campaign(seed=1)
    named = {
        mode: recipe_for(mode, 0, campaign).to_dict()["conditions"].get("pedestrian")
        for mode in ("benign_pedestrian", "benign_obstacle", "lidar_passthrough_odom")
    }
    assert named == {
        "benign_pedestrian": True, "benign_obstacle": None, "lidar_passthrough_odom": None
    }  # fmt: skip
