import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.middleware.tf import TransformBuffer, planar_transform
from sim.nav2.collision_monitor import (
    POLYGON_SLOW,
    POLYGON_STOP,
    CollisionMonitor,
    points_inside,
    range_points,
)
from sim.nav2.messages import TWIST, twist_message

LaserScan = message_class("sensor_msgs/msg/LaserScan")
Range = message_class("sensor_msgs/msg/Range")
TFMessage = message_class("tf2_msgs/msg/TFMessage")


def scan_of(time_ns, points, frame="base_footprint"):
    """A scan whose first beams end at ``points`` and whose others see nothing."""
    beams = 8
    points = np.array(points).reshape(-1, 2)
    ranges = np.full(beams, np.inf, np.float32)
    ranges[: len(points)] = np.hypot(points[:, 0], points[:, 1])
    angle = math.atan2(points[0, 1], points[0, 0]) if len(points) else 0.0
    no_intensities = np.zeros(0, np.float32)
    return LaserScan(
        header(time_ns, frame), angle, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0, ranges, no_intensities
    )


class Rig:
    """A monitor in a world where ``base_footprint`` is where the test says in ``odom``."""

    def __init__(self, **options):
        self.domain = Domain(Executor())
        self.node = Node(self.domain, "/test")
        self.buffer = TransformBuffer()
        self.place(Pose2D())
        self.commands = self.node.create_publisher(TWIST, "/cmd_vel_raw")
        self.sent = []
        self.monitor = CollisionMonitor(self.domain, self.buffer, **options)
        self.monitor.configure()
        self.monitor.activate()
        self.node.create_subscription(
            TWIST, "/cmd_vel", lambda m: self.sent.append((m.linear.x, m.angular.z))
        )

    def place(self, pose):
        transform = planar_transform(self.node.now_ns, "odom", "base_footprint", pose)
        self.buffer.receive(TFMessage([transform]), static=False)

    def see(self, *points, topic="/scan"):
        publisher = self.node.create_publisher("sensor_msgs/msg/LaserScan", topic)
        publisher.publish(scan_of(self.node.now_ns, points))

    def command(self, linear=0.2, angular=0.5):
        """Return the monitor's answer to a command, None without one."""
        self.sent.clear()
        self.commands.publish(twist_message(linear, angular))
        self.domain.executor.run_until(self.node.now_ns + 1)
        return self.sent[0] if self.sent else None


@pytest.fixture
def rig():
    return Rig()


IN_STOP = [(0.2, 0.1)] * 4
IN_SLOW = [(POLYGON_SLOW.vertices[:, 0].max() - 0.02, 0.1)] * 4


def test_without_points_commands_are_forwarded_unchanged(rig):
    assert rig.command() == (0.2, 0.5)


@pytest.mark.parametrize(("points", "stopped"), [(3, False), (4, True)])
def test_more_points_than_max_points_stop_the_robot(rig, points, stopped):
    rig.see(*IN_STOP[:points])
    assert (rig.command() == (0.0, 0.0)) == stopped


def test_the_slowdown_polygon_scales_both_components(rig):
    rig.see(*IN_SLOW)
    assert rig.command() == pytest.approx((0.06, 0.15))


def test_stop_wins_over_slowdown_whatever_the_order_of_the_sources(rig):
    rig.see(*IN_SLOW, topic="/scan")
    rig.see(*IN_STOP, topic="/scan_tom")
    assert rig.command() == (0.0, 0.0)


def test_points_of_all_sources_count_together(rig):
    rig.see(*IN_STOP[:2], topic="/scan")
    rig.see(*IN_STOP[:2], topic="/scan_fakeobject")
    assert rig.command() == (0.0, 0.0)


def test_a_source_older_than_five_seconds_is_ignored(rig):
    rig.see(*IN_STOP)
    rig.domain.executor.run_until(5 * SECOND - 2)
    assert rig.command() == (0.0, 0.0)
    rig.domain.executor.run_until(5 * SECOND + 1)
    assert rig.command() == (0.2, 0.5)


def test_the_robots_own_motion_since_the_scan_is_taken_out(rig):
    rig.see(*[(0.5, 0.0)] * 4)  # out of reach of both polygons
    assert rig.command() == (0.2, 0.5)
    rig.domain.executor.run_until(100 * MILLISECOND)
    rig.place(Pose2D(0.3, 0.0))  # now 0.2 m ahead
    assert rig.command() == (0.0, 0.0)
    rig.place(Pose2D(0.3, 0.0, math.pi))  # now behind
    assert rig.command() != (0.0, 0.0)


def test_a_scan_in_an_unknown_frame_has_no_points(rig):
    publisher = rig.node.create_publisher("sensor_msgs/msg/LaserScan", "/scan")
    publisher.publish(scan_of(0, IN_STOP, frame="nowhere"))
    assert rig.command() == (0.2, 0.5)


def test_a_scan_newer_than_the_odometry_waits_and_the_previous_one_is_used(rig):
    rig.see(*IN_STOP)
    rig.domain.executor.run_until(200 * MILLISECOND)
    rig.see()  # nothing there any more, but where was the robot?
    assert rig.command() == (0.0, 0.0)
    rig.place(Pose2D())
    assert rig.command() == (0.2, 0.5)


def test_a_halted_robot_gets_no_more_commands_after_two_seconds(rig):
    rig.see(*IN_STOP)
    assert rig.command() == (0.0, 0.0)
    rig.domain.executor.run_until(2 * SECOND)
    assert rig.command() == (0.0, 0.0)
    rig.domain.executor.run_until(2 * SECOND + MILLISECOND)
    assert rig.command() is None
    rig.place(Pose2D())
    rig.see()
    assert rig.command() == (0.2, 0.5)


def test_polygons_are_shown_at_activation_and_with_every_command(rig):
    shapes = []
    rig.node.create_subscription(
        "geometry_msgs/msg/PolygonStamped", "/polygon_stop", lambda m: shapes.append(m)
    )
    rig.command()
    rig.command()
    assert len(shapes) == 2
    corners = [(p.x, p.y) for p in shapes[0].polygon.points]
    assert corners == [tuple(v) for v in POLYGON_STOP.vertices.astype(np.float32).tolist()]


def test_a_range_is_an_arc_with_a_point_a_degree_and_one_at_each_end():
    points = range_points(Range(header(0, "range_ella"), 1, 0.2, 0.05, 2.0, 0.5), Pose2D())
    assert len(points) == 13  # 11.46 degrees: twelve points at whole degrees, and the last
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx(np.full(13, 0.5))
    bearings = np.arctan2(points[:, 1], points[:, 0])
    assert bearings[[0, -1]] == pytest.approx([-0.1, 0.1])
    assert np.diff(bearings)[:-1] == pytest.approx(np.full(11, math.radians(1.0)))


@pytest.mark.parametrize("value", [0.01, 2.5, math.inf, -math.inf])
def test_a_range_outside_the_sensors_limits_has_no_points(value):
    assert (
        len(range_points(Range(header(0, "range_ella"), 1, 0.2, 0.05, 2.0, value), Pose2D())) == 0
    )


def test_the_infrared_alone_can_stop_the_robot(rig):
    publisher = rig.node.create_publisher("sensor_msgs/msg/Range", "/range_ella")
    publisher.publish(Range(header(0, "base_footprint"), 1, 0.2, 0.05, 2.0, 0.25))
    assert rig.command() == (0.0, 0.0)


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=30))
def test_points_inside_a_rectangle_are_those_between_its_sides(points):
    points = np.array(points).reshape(-1, 2)
    x, y = points[:, 0], points[:, 1]
    edges = np.minimum.reduce([abs(x), abs(x - 0.3), abs(y - 0.3), abs(y + 0.3)])
    points = points[edges > 1e-9]  # on an edge, either answer will do
    x, y = points[:, 0], points[:, 1]
    expected = ((x > 0.0) & (x < 0.3) & (abs(y) < 0.3)).sum()
    assert points_inside(POLYGON_STOP.vertices, points) == expected


def test_points_inside_a_concave_polygon_by_hand():
    arrow = np.array([(0.0, 0.0), (2.0, 1.0), (0.0, 2.0), (0.8, 1.0)])
    assert points_inside(arrow, np.array([(1.5, 1.0), (0.4, 1.0), (0.5, 0.5)])) == 2
