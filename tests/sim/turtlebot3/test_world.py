import hashlib
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D, wrap_angle
from sim.turtlebot3.arena import BLOCKS, CYLINDERS, HEXAGON, RING, Cylinder
from sim.turtlebot3.floor_plans import draw_arena
from sim.turtlebot3.mjcf import WHEEL_RADIUS_M, WHEEL_SEPARATION_M, WorldParameters
from sim.turtlebot3.world import World

BEARINGS = np.linspace(0.0, 6.28, 90)
HEIGHT_M = 0.132


def drive(world, forward, turning, seconds):
    turn = turning * WHEEL_SEPARATION_M / 2.0
    world.command_wheels((forward - turn) / WHEEL_RADIUS_M, (forward + turn) / WHEEL_RADIUS_M)
    world.advance_to(world.time_ns + round(seconds * SECOND))


def slow_ray(arena, sensor, bearing):
    """March along one ray until a surface is reached: obvious, and good to a tenth of a mm."""
    direction = np.array([math.cos(sensor.yaw + bearing), math.sin(sensor.yaw + bearing)])
    distance = 0.0
    while distance < 20.0:
        free = arena.clearance((np.array([sensor.x, sensor.y]) + distance * direction)[None])[0]
        if free < 1e-4:
            return distance
        distance += free
    return math.inf


@pytest.mark.slow
@settings(max_examples=25)
@given(
    st.sampled_from([HEXAGON, draw_arena("house", 1), draw_arena("random", 2)]),
    st.floats(-2.5, 2.5), st.floats(-2.4, 2.4), st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_rays_end_where_a_slow_march_through_the_geometry_ends(arena, x, y, yaw):
    if arena.clearance(np.array([[x, y]]))[0] < 0.3:
        return
    world = World(WorldParameters(Pose2D(x, y, yaw), arena=arena))
    mount = Pose2D(-0.064, 0.0, 0.0)
    measured = world.scan(mount, HEIGHT_M, BEARINGS, 20.0)
    sensor = world.pose.compose(mount)
    expected = [slow_ray(arena, sensor, bearing) for bearing in BEARINGS]
    # A ray that grazes an edge may end on either side of it.
    agree = np.abs(measured - expected) < 5e-3
    assert agree.mean() >= 0.97


def test_a_scan_never_sees_the_robot_itself():
    world = World(WorldParameters(Pose2D(0.55, 0.55, 0.3)))
    assert world.scan(Pose2D(-0.064, 0.0), HEIGHT_M, BEARINGS, 20.0).min() > 0.5


def test_beyond_its_reach_a_sensor_sees_nothing():
    world = World(WorldParameters(Pose2D(0.55, 0.55, 0.3)))
    assert np.isinf(world.scan(Pose2D(), HEIGHT_M, BEARINGS, 0.3)).all()


def test_an_added_obstacle_is_seen_and_can_be_touched():
    obstacle = Cylinder("crate", 0.55, 0.0, radius=0.1)
    world = World(WorldParameters(Pose2D(0.55, 0.55, -math.pi / 2), obstacles=[obstacle]))
    assert world.scan(Pose2D(), HEIGHT_M, np.zeros(1), 20.0)[0] == pytest.approx(0.45, abs=1e-3)
    drive(world, 0.2, 0.0, 4.0)
    assert [touch.piece for touch in world.touches] == ["crate"]


def test_a_robot_that_is_not_commanded_stays_where_it_is():
    world = World(WorldParameters(Pose2D(-2.0, -0.5, 0.4)))
    world.advance_to(60 * SECOND)
    assert world.pose.distance_to(Pose2D(-2.0, -0.5)) < 1e-3
    assert abs(world.pose.yaw - 0.4) < 1e-3
    assert world.touches == []


@pytest.mark.parametrize("mass", [0.9, 1.1])
@pytest.mark.parametrize("friction", [0.8, 1.2])
def test_wheels_move_the_robot_by_the_commanded_distance(mass, friction):
    world = World(WorldParameters(Pose2D(-0.55, -0.55, 0.0), friction, mass))
    drive(world, 0.2, 0.0, 5.0)
    assert world.pose.x + 0.55 == pytest.approx(1.0, rel=0.02)
    before = world.pose.yaw
    drive(world, 0.0, 0.5, 4.0)
    # The wheels stand 0.288 m apart and are driven as if it were 0.287 m.
    assert wrap_angle(world.pose.yaw - before) == pytest.approx(2.0, rel=0.015)


def last_imu(world):
    """Advance by one step; return its angular velocity and acceleration."""
    samples = world.imu(world.time_ns + 5_000_000)
    world.advance_to(world.time_ns + 5_000_000)
    return samples.angular_velocities[-1], samples.linear_accelerations[-1]


def test_touching_a_pillar_is_one_episode_with_its_name_and_time():
    world = World(WorldParameters(Pose2D(-2.0, 0.0, 0.0)))
    assert HEXAGON.clearance(np.array([[-2.0, 0.0]]))[0] > 0.3
    drive(world, 0.2, 0.0, 8.0)
    (touch,) = world.touches
    assert touch.piece == "one_two"
    # The front of the box is 0.0685 m ahead, the wheels' hull is no wider than the box here.
    gap = -1.1 - 0.15 - (-2.0 + 0.0685)
    assert touch.stamp_ns / SECOND == pytest.approx(gap / 0.2, abs=0.15)


def test_an_imu_at_rest_measures_gravity_upwards_and_no_turning():
    world = World(WorldParameters(Pose2D(-2.0, -0.5, 0.0)))
    world.advance_to(SECOND)
    turning, acceleration = last_imu(world)
    # The casters end a millimetre above the wheels' lowest point: the robot leans back a little.
    lean = 9.8 * 0.001 / 0.177
    assert acceleration == pytest.approx([lean, 0.0, 9.8], abs=0.02)
    assert turning == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    drive(world, 0.0, 0.5, 2.0)
    turning, _ = last_imu(world)
    assert turning[2] == pytest.approx(0.5, rel=0.03)


def test_the_physics_does_not_depend_on_the_length_of_its_blocks():
    stride, blocks = World(WorldParameters(Pose2D())), World(WorldParameters(Pose2D()))
    for world in (stride, blocks):
        world.command_wheels(3.0, 4.0)
    stride.advance_to(SECOND)
    for time_ns in (3_000_000, 5_000_000, 34_000_000, 500_000_000, SECOND):
        blocks.advance_to(time_ns)
        blocks.imu(time_ns + 1_000_000)
    assert blocks.pose == stride.pose
    assert blocks.twist == stride.twist
    assert blocks.wheel_states() == stride.wheel_states()


def test_imu_samples_are_those_of_the_steps_after_now_and_do_not_move_the_robot():
    world = World(WorldParameters(Pose2D()))
    world.command_wheels(3.0, 3.0)
    world.advance_to(34_000_000)
    pose = world.pose
    samples = world.imu(68_000_000)
    assert list(samples.stamps_ns) == [ms * 1_000_000 for ms in (35, 40, 45, 50, 55, 60, 65)]
    assert world.pose == pose
    assert world.imu(68_000_000).linear_accelerations.tolist() == (
        samples.linear_accelerations.tolist()
    )


def test_a_command_that_comes_too_late_for_samples_already_given_is_refused():
    world = World(WorldParameters(Pose2D()))
    world.imu(34_000_000)
    with pytest.raises(ValueError, match="gone on"):
        world.command_wheels(1.0, 1.0)
    world.advance_to(34_000_000)
    world.command_wheels(1.0, 1.0)


def test_starting_and_stopping_do_not_make_the_robot_hop():
    world = World(WorldParameters(Pose2D(-0.9, -1.7, 0.0)))
    world.advance_to(SECOND)
    up = []
    ramp = [*range(8), *[8] * 30, *reversed(range(8)), *[0] * 15]  # updates of the diff drive
    for rung in ramp:
        world.command_wheels(*[min(rung * 0.034, 0.26) / WHEEL_RADIUS_M] * 2)
        for _ in range(7):
            _, acceleration = last_imu(world)
            up.append(acceleration[2])
    assert np.ptp(up) < 2.0  # a hop would fall freely, then hit the floor: -5 to 27 m/s^2


def test_the_pose_moves_evenly_between_the_steps_of_the_physics():
    world = World(WorldParameters(Pose2D(-0.9, -1.7, 0.0)))
    drive(world, 0.26, 0.0, 1.0)
    xs = []
    for _ in range(50):
        world.advance_to(SECOND + 34_000_000 * len(xs))
        xs.append(world.pose.x)
    np.testing.assert_allclose(np.diff(xs) / 0.034, world.twist[0], rtol=1e-3)


def test_every_piece_of_the_arena_stands_in_the_physics():
    names = {piece.name for piece in (RING, *BLOCKS, *CYLINDERS)}
    assert set(World(WorldParameters(Pose2D(-2.0, -0.5)))._pieces) == names


FINGERPRINT = """
import hashlib
from sim.middleware.geometry import Pose2D
from sim.turtlebot3.floor_plans import draw_arena
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.world import World
world = World(WorldParameters(Pose2D(-2.0, -0.5, 0.1), 0.9, 1.05))
world.command_wheels(5.0, 7.0)
world.advance_to(10_000_000_000)
print(hashlib.sha256(repr((world.pose, world.twist, world.touches)).encode()).hexdigest())
"""


@pytest.mark.slow
def test_the_same_commands_give_the_same_bits_in_another_process():
    world = World(WorldParameters(Pose2D(-2.0, -0.5, 0.1), 0.9, 1.05))
    world.command_wheels(5.0, 7.0)
    for time_ns in range(0, 10 * SECOND + 1, 34_000_000):
        world.advance_to(time_ns)
    world.advance_to(10 * SECOND)
    state = repr((world.pose, world.twist, world.touches))
    other = subprocess.run(
        [sys.executable, "-c", FINGERPRINT], capture_output=True, text=True, check=True
    )
    assert other.stdout.strip() == hashlib.sha256(state.encode()).hexdigest()
