import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class, serialize
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.middleware.tf import TransformListener
from sim.turtlebot3.drive import next_set_point
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.nodes import add_robot
from sim.turtlebot3.sensors import LidarNoise, SensorErrors, noisy_ranges
from sim.turtlebot3.world import World

Twist = message_class("geometry_msgs/msg/Twist")
Vector3 = message_class("geometry_msgs/msg/Vector3")

# Messages a simulated second on Humble (nominal or measured; fact sheet, section 2.4).
RATES = {
    "/clock": 10.0,
    "/imu": 200.0,
    "/joint_states": 29.4,
    "/odom": 29.4,
    "/performance_metrics": 5.0,
    "/range_ella": 5.0,
    "/scan": 5.0,
    "/scan_tom": 5.0,
}


START = Pose2D(-2.0, -0.5, 0.0)


class Robot:
    def __init__(self, start=START):
        self.world = World(WorldParameters(start))
        self.executor = Executor(self.world.advance_to)
        self.domain = Domain(self.executor)
        add_robot(
            self.domain, self.world, SensorErrors(), lambda name: np.random.default_rng(len(name))
        )
        self.tester = Node(self.domain, "/tester")
        self.heard = {}

    def listen(self, topic, profile=qos.SENSOR_DATA):
        self.heard[topic] = []
        self.tester.create_subscription(
            self.domain.topics[topic], topic, self.heard[topic].append, profile
        )


def test_topics_come_at_their_rates_on_humble():
    robot = Robot()
    for topic in RATES:
        robot.listen(topic)
    robot.executor.run_until(20 * SECOND)
    rates = {topic: len(messages) / 20.0 for topic, messages in robot.heard.items()}
    assert rates == pytest.approx(RATES, rel=0.02)


@pytest.mark.parametrize("topic", [*RATES, "/tf"])
def test_the_bytes_of_a_message_are_those_of_the_object_that_others_receive(topic):
    robot, recorded = Robot(Pose2D(-0.55, -0.55, 0.0)), []
    robot.listen(topic)
    for publisher in robot.domain.publishers(topic):
        publisher.tap(recorded.append)
    command = robot.tester.create_publisher("geometry_msgs/msg/Twist", "/cmd_vel", qos.RELIABLE)
    command.publish(Twist(Vector3(0.2, 0.0, 0.0), Vector3(0.0, 0.0, 0.1)))
    robot.executor.run_until(2 * SECOND)
    msgtype = robot.domain.topics[topic]
    assert [serialize(message, msgtype) for message in robot.heard[topic]] == recorded


def test_wheel_transforms_come_at_the_rate_measured_on_humble():
    robot = Robot()
    robot.listen("/tf")
    robot.executor.run_until(40 * SECOND)
    wheels = [m for m in robot.heard["/tf"] if len(m.transforms) == 2]
    assert len(wheels) / 40.0 == pytest.approx(19.4, rel=0.01)


def test_a_velocity_command_moves_the_robot_and_odometry_is_correct():
    robot = Robot(Pose2D(-0.55, -0.55, 0.0))
    robot.listen("/odom")
    command = robot.tester.create_publisher("geometry_msgs/msg/Twist", "/cmd_vel", qos.RELIABLE)
    command.publish(Twist(Vector3(0.2, 0.0, 0.0), Vector3(0.0, 0.0, 0.1)))
    robot.executor.run_until(3 * SECOND)
    odometry = robot.heard["/odom"][-1]
    truth = robot.world.pose
    assert odometry.pose.pose.position.x == pytest.approx(truth.x, abs=0.01)
    assert truth.x > -0.05
    assert odometry.twist.twist.linear.x == pytest.approx(0.2, rel=0.05)
    assert odometry.twist.twist.angular.z == pytest.approx(0.1, rel=0.05)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_footprint")


rim_speeds = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))


@given(rim_speeds, rim_speeds)
def test_wheels_reach_their_target_at_no_more_than_one_metre_a_second_squared(now, target):
    for _ in range(40):
        before, now = now, next_set_point(now, target)
        assert max(abs(a - b) for a, b in zip(now, before, strict=True)) <= 0.034 + 1e-9
    assert now == pytest.approx(target, abs=0.01)


@pytest.mark.parametrize(
    ("exact", "reported"), [(25.0, math.inf), (math.inf, math.inf), (0.05, -math.inf)]
)
def test_ranges_outside_the_limits_are_reported_as_rep_117_says(exact, reported):
    rng = np.random.default_rng(0)
    assert noisy_ranges(np.array([exact]), LidarNoise(sd_m=0.0), rng)[0] == reported


def test_lidar_noise_has_the_bias_and_the_spread_it_was_given():
    rng = np.random.default_rng(0)
    error = noisy_ranges(np.full(20_000, 2.0), LidarNoise(0.012, -0.005), rng) - 2.0
    assert error.mean() == pytest.approx(-0.005, abs=5e-4)
    assert error.std() == pytest.approx(0.012, rel=0.03)


def test_the_frames_are_connected_as_on_the_robot():
    robot = Robot()
    buffer = TransformListener(robot.domain, "0").buffer
    robot.executor.run_until(SECOND)
    scan = buffer.lookup("base_footprint", "base_scan")
    assert (scan.x, scan.y) == pytest.approx((-0.064, 0.0))
    assert buffer.lookup("base_link", "base_scan_tom").x == pytest.approx(0.116)
    in_odom = buffer.lookup("odom", "base_footprint")
    assert in_odom.distance_to(START) < 1e-3


def test_the_robot_description_is_a_tree_of_every_frame():
    robot = Robot()
    robot.listen("/robot_description", qos.LATCHED)
    robot.listen("/tf_static", qos.LATCHED)
    robot.executor.run_until(0)
    (description,) = robot.heard["/robot_description"]
    urdf = ET.fromstring(description.data)  # noqa: S314 -- our own
    links = {link.get("name") for link in urdf.iter("link")}
    children = [joint.find("child").get("link") for joint in urdf.iter("joint")]
    assert len(children) == len(set(children))
    assert links == {"base_footprint", *children}
    (static,) = robot.heard["/tf_static"]
    assert {t.child_frame_id for t in static.transforms} <= links


def test_the_second_lidar_measures_the_same_world_from_its_mount():
    robot = Robot()
    robot.listen("/scan")
    robot.listen("/scan_tom")
    robot.executor.run_until(SECOND)
    ahead, ahead_tom = robot.heard["/scan"][-1].ranges[0], robot.heard["/scan_tom"][-1].ranges[0]
    assert ahead - ahead_tom == pytest.approx(0.116 + 0.064, abs=0.06)
