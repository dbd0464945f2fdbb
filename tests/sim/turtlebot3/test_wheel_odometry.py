import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.geometry import Pose2D, quaternion_yaw, wrap_angle
from sim.middleware.node import Node
from sim.middleware.tf import TransformListener
from sim.turtlebot3.map import WORLD_IN_MAP, odom_in_map
from sim.turtlebot3.mjcf import WHEEL_RADIUS_M, WHEEL_SEPARATION_M, WorldParameters
from sim.turtlebot3.nodes import add_robot
from sim.turtlebot3.sensors import SensorErrors
from sim.turtlebot3.wheel_odometry import WheelOdometry
from sim.turtlebot3.world import World

Twist = message_class("geometry_msgs/msg/Twist")
Vector3 = message_class("geometry_msgs/msg/Vector3")

START = Pose2D(-0.55, -0.55, 0.05)


class Wheels:
    """Two wheels that turn as for an ideal robot with these speeds."""

    def __init__(self, forward, turning):
        rim = np.array([-0.5, 0.5]) * turning * WHEEL_SEPARATION_M + forward
        self.speeds = (rim / WHEEL_RADIUS_M).tolist()
        self.angles = [3.0, -7.0]

    def turn(self, seconds):
        self.angles = [a + s * seconds for a, s in zip(self.angles, self.speeds, strict=True)]

    def measure(self):
        return self.angles, self.speeds


@given(st.floats(-0.26, 0.26), st.floats(-1.0, 1.0).filter(lambda w: abs(w) > 1e-3))
def test_even_wheels_drive_an_arc_from_where_odometry_begins(forward, turning):
    wheels = Wheels(forward, turning)
    odometry = WheelOdometry(wheels.measure)
    assert odometry()[0] == Pose2D()
    for _ in range(100):
        wheels.turn(0.034)
        pose, twist = odometry()
    radius, angle = forward / turning, turning * 3.4
    assert pose.x == pytest.approx(radius * math.sin(angle), abs=1e-3)
    assert pose.y == pytest.approx(radius * (1.0 - math.cos(angle)), abs=1e-3)
    assert wrap_angle(pose.yaw - angle) == pytest.approx(0.0, abs=1e-9)
    assert twist == pytest.approx((forward, turning))


@given(st.floats(-0.26, 0.26), st.integers(1, 20))
def test_the_number_of_updates_does_not_change_a_straight_path(forward, updates):
    wheels = Wheels(forward, 0.0)
    odometry = WheelOdometry(wheels.measure)
    for _ in range(updates):
        wheels.turn(1.0 / updates)
        pose, _ = odometry()
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((forward, 0.0, 0.0))


def drive(source, seconds):
    """Return the world, odometry messages and transforms of a robot that drives a bend."""
    world = World(WorldParameters(START))
    executor = Executor(world.advance_to)
    domain = Domain(executor)
    add_robot(
        domain, world, SensorErrors(), lambda _: np.random.default_rng(0), odometry_source=source
    )
    tester = Node(domain, "/tester")
    buffer = TransformListener(domain, "0").buffer
    heard = []
    tester.create_subscription("nav_msgs/msg/Odometry", "/odom", heard.append)
    command = tester.create_publisher("geometry_msgs/msg/Twist", "/cmd_vel", qos.RELIABLE)
    command.publish(Twist(Vector3(0.2, 0.0, 0.0), Vector3(0.0, 0.0, 0.1)))
    executor.run_until(round(seconds * SECOND))
    return world, heard, buffer


def pose_of(odometry):
    position, q = odometry.pose.pose.position, odometry.pose.pose.orientation
    return Pose2D(position.x, position.y, quaternion_yaw(q.x, q.y, q.z, q.w))


def test_encoder_odometry_starts_at_zero_and_stays_close_to_the_truth_but_not_on_it():
    world, heard, buffer = drive("encoder", 3.0)
    assert pose_of(heard[0]).distance_to(Pose2D()) < 1e-3
    truth, estimated = START.inverse().compose(world.pose), pose_of(heard[-1])
    assert truth.x > 0.5
    assert 0.0 < estimated.distance_to(truth) < 0.01
    assert 0.0 < abs(estimated.yaw - truth.yaw) < 0.01
    assert buffer.lookup("odom", "base_footprint").distance_to(estimated) < 1e-9
    assert heard[-1].twist.twist.linear.x == pytest.approx(0.2, rel=0.02)
    assert heard[-1].twist.twist.angular.z == pytest.approx(0.1, rel=0.02)


def test_odometry_overstates_a_turn_by_separation_and_slip_and_no_more():
    world = World(WorldParameters(START))
    odometry = WheelOdometry(world.wheel_states)
    wheels = Wheels(0.0, 0.5)
    world.command_wheels(*wheels.speeds)
    world.advance_to(5 * SECOND)
    estimated, _ = odometry()
    assert 1.0035 < estimated.yaw / wrap_angle(world.pose.yaw - START.yaw) < 1.01


@pytest.mark.parametrize("source", ["world", "encoder"])
def test_the_odometry_frame_has_the_documented_pose_on_the_map(source):
    _, heard, _ = drive(source, 0.1)
    start = WORLD_IN_MAP.compose(START)
    on_map = odom_in_map(source, start).compose(pose_of(heard[0]))
    assert on_map.distance_to(start) < 2e-3
    assert abs(wrap_angle(on_map.yaw - start.yaw)) < 2e-3
