"""Gazebo's plugins of the wheels, as nodes: differential drive, odometry and joint states."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D, yaw_quaternion
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.middleware.tf import TransformBroadcaster, planar_transform, transforms_template
from sim.turtlebot3 import frames
from sim.turtlebot3.mjcf import WHEEL_RADIUS_M, WHEEL_SEPARATION_M
from sim.turtlebot3.wheel_odometry import Wheels

_JointState = message_class("sensor_msgs/msg/JointState")
_Odometry = message_class("nav_msgs/msg/Odometry")
_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Twist = message_class("geometry_msgs/msg/Twist")
_TwistWithCovariance = message_class("geometry_msgs/msg/TwistWithCovariance")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_JOINT_STATE = "sensor_msgs/msg/JointState"
_ODOMETRY = "nav_msgs/msg/Odometry"

# Of the diff drive's pose and twist: x, y and yaw, with the covariances of the plugin.
_ODOMETRY_COVARIANCE = np.diag([1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3]).ravel()
_ODOMETRY_COVARIANCE.setflags(write=False)

ODOMETRY_NS = 34 * MILLISECOND  # nominally 30 Hz, in steps of 1 ms

WHEEL_ACCELERATION = 1.0  # at the rim [m/s^2]
_CLOSE_ENOUGH = 0.01  # wheel speeds this close to their target are set to it [m/s]


class DiffDrivePlugin(Node):
    """Turns ``/cmd_vel`` into wheel speeds; publishes ``/odom`` and ``odom -> base_footprint``.

    The last command is held until the next one. Each update changes the set-points of the wheels by
    at most the acceleration times the period. Odometry comes from one of the plugin's two sources
    (`wheel_odometry`).
    """

    def __init__(
        self,
        domain: Domain,
        odometry: Callable[[], tuple[Pose2D, tuple[float, float]]],
        command_wheels: Callable[[float, float], None],
    ) -> None:
        super().__init__(domain, "/turtlebot3_diff_drive")
        self._odometry = odometry
        self._command_wheels = command_wheels
        self._target = (0.0, 0.0)  # rim speeds, left and right [m/s]
        self._set_point = (0.0, 0.0)
        self._publisher = self.create_publisher(_ODOMETRY, "/odom", qos.RELIABLE)
        self._tf = TransformBroadcaster(self)
        self._odometry_bytes = Template(
            _odometry_message(0, Pose2D(), 0.0, 0.0),
            _ODOMETRY,
            (*STAMP, "pose.pose", "twist.twist"),
        )
        self._tf_bytes = transforms_template([_odom_transform(0, Pose2D())])
        self.create_subscription(
            "geometry_msgs/msg/Twist", "/cmd_vel", self._on_command, qos.RELIABLE
        )
        self.create_timer(ODOMETRY_NS, self._update)

    def _on_command(self, twist: Any) -> None:
        turn = twist.angular.z * WHEEL_SEPARATION_M / 2.0
        self._target = (twist.linear.x - turn, twist.linear.x + turn)

    def _update(self) -> None:
        left, right = self._set_point = next_set_point(self._set_point, self._target)
        self._command_wheels(left / WHEEL_RADIUS_M, right / WHEEL_RADIUS_M)
        pose, (forward, turning) = self._odometry()
        now_ns = self.now_ns
        stamp = divmod(now_ns, SECOND)
        where = (pose.x, pose.y, 0.0, *yaw_quaternion(pose.yaw))
        self._publisher.publish(
            _odometry_message(now_ns, pose, forward, turning),
            self._odometry_bytes.data(*stamp, where, (forward, 0.0, 0.0, 0.0, 0.0, turning)),
        )
        self._tf.send([_odom_transform(now_ns, pose)], self._tf_bytes.data(*stamp, where))


def _odometry_message(time_ns: int, pose: Pose2D, forward: float, turning: float) -> Any:
    return _Odometry(
        header(time_ns, "odom"),
        "base_footprint",
        _PoseWithCovariance(
            _Pose(_Point(pose.x, pose.y, 0.0), _Quaternion(*yaw_quaternion(pose.yaw))),
            _ODOMETRY_COVARIANCE,
        ),
        _TwistWithCovariance(
            _Twist(_Vector3(forward, 0.0, 0.0), _Vector3(0.0, 0.0, turning)), _ODOMETRY_COVARIANCE
        ),
    )


def _odom_transform(time_ns: int, pose: Pose2D) -> Any:
    return planar_transform(time_ns, "odom", "base_footprint", pose)


def next_set_point(now: tuple[float, float], target: tuple[float, float]) -> tuple[float, float]:
    """Return the next set-points of the wheels [m/s], as Gazebo's diff drive computes them."""
    (left, right), (to_left, to_right) = now, target
    if abs(to_left - left) < _CLOSE_ENOUGH and abs(to_right - right) < _CLOSE_ENOUGH:
        return target
    return _towards(left, to_left), _towards(right, to_right)


def _towards(now: float, target: float) -> float:
    step = WHEEL_ACCELERATION * ODOMETRY_NS / SECOND
    return now + math.copysign(min(abs(target - now), step), target - now)


class JointStatePlugin(Node):
    """``/joint_states`` of the two wheels."""

    def __init__(self, domain: Domain, measure: Callable[[], tuple[Wheels, Wheels]]) -> None:
        super().__init__(domain, "/turtlebot3_joint_state")
        self._measure = measure
        self._publisher = self.create_publisher(_JOINT_STATE, "/joint_states", qos.profile(1000))
        self._bytes = Template(
            _joint_state(0, (0.0, 0.0), (0.0, 0.0)), _JOINT_STATE, (*STAMP, "position", "velocity")
        )
        self.create_timer(ODOMETRY_NS, self._publish)

    def _publish(self) -> None:
        angles, speeds = self._measure()
        stamp = divmod(self.now_ns, SECOND)
        self._publisher.publish(
            _joint_state(self.now_ns, angles, speeds), self._bytes.data(*stamp, angles, speeds)
        )


def _joint_state(time_ns: int, angles: Wheels, speeds: Wheels) -> Any:
    names = list(frames.WHEEL_JOINTS)
    no_effort = np.zeros(0)
    return _JointState(header(time_ns, ""), names, np.array(angles), np.array(speeds), no_effort)
