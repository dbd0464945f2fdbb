"""Gazebo's plugins of the wheels, as nodes: differential drive, odometry and joint states."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.middleware.tf import TransformBroadcaster, transforms_template
from sim.turtlebot3 import frames
from sim.turtlebot3.mjcf import WHEEL_RADIUS_M, WHEEL_SEPARATION_M
from sim.turtlebot3.wheel_odometry import Wheels

_JointState = message_class("sensor_msgs/msg/JointState")
_Odometry = message_class("nav_msgs/msg/Odometry")
_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Transform = message_class("geometry_msgs/msg/Transform")
_TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
_Twist = message_class("geometry_msgs/msg/Twist")
_TwistWithCovariance = message_class("geometry_msgs/msg/TwistWithCovariance")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_JOINT_STATE = "sensor_msgs/msg/JointState"
_ODOMETRY = "nav_msgs/msg/Odometry"

# Of the diff drive's pose and twist: x, y and yaw, with the covariances of the plugin.
_ODOMETRY_COVARIANCE = np.diag([1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3]).ravel()
_ODOMETRY_COVARIANCE.setflags(write=False)
_JOINTS, _NO_EFFORT = list(frames.WHEEL_JOINTS), np.zeros(0)

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
        odometry, transform = _messages(0, Pose2D(), (0.0, 1.0), (0.0, 0.0))
        fields = (*STAMP, "pose.pose", "twist.twist")
        self._odometry_row = Template(odometry, _ODOMETRY, fields).rows(1)
        self._transform_row = transforms_template([transform]).rows(1)
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
        pose, twist = self._odometry()
        now_ns = self.now_ns
        odometry_row, transform_row = self._odometry_row, self._transform_row
        rotation = _fill_in(odometry_row, transform_row, now_ns, pose.x, pose.y, pose.yaw, *twist)
        odometry, transform = _messages(now_ns, pose, rotation, twist)
        self._publisher.publish(odometry, odometry_row.tobytes())
        self._tf.send([transform], transform_row.tobytes())


@jit
def _fill_in(
    odometry: NDArray[np.void], transform: NDArray[np.void], now_ns: int,
    x: float, y: float, yaw: float, forward: float, turning: float,
) -> tuple[float, float]:  # fmt: skip
    """Write the numbers of the odometry and of its transform; return z and w of the rotation."""
    z, w = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
    row, other = odometry[0], transform[0]
    row["header.stamp.sec"] = other["transforms.0.header.stamp.sec"] = now_ns // SECOND
    row["header.stamp.nanosec"] = other["transforms.0.header.stamp.nanosec"] = now_ns % SECOND
    for where in (row["pose.pose"], other["transforms.0.transform"]):
        where[0], where[1], where[5], where[6] = x, y, z, w
    row["twist.twist"][0], row["twist.twist"][5] = forward, turning
    return z, w


def _messages(
    time_ns: int, pose: Pose2D, rotation: tuple[float, float], twist: tuple[float, float]
) -> tuple[Any, Any]:
    """Return the odometry and its transform, which share their header and rotation."""
    stamped, turned = header(time_ns, "odom"), _Quaternion(0.0, 0.0, *rotation)
    forward, turning = twist
    odometry = _Odometry(
        stamped,
        "base_footprint",
        _PoseWithCovariance(_Pose(_Point(pose.x, pose.y, 0.0), turned), _ODOMETRY_COVARIANCE),
        _TwistWithCovariance(
            _Twist(_Vector3(forward, 0.0, 0.0), _Vector3(0.0, 0.0, turning)), _ODOMETRY_COVARIANCE
        ),
    )
    moved = _Transform(_Vector3(pose.x, pose.y, 0.0), turned)
    return odometry, _TransformStamped(stamped, "base_footprint", moved)


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
        fields = (*STAMP, "position", "velocity")
        self._bytes = Template(_joint_state(0, (0.0, 0.0), (0.0, 0.0)), _JOINT_STATE, fields)
        self.create_timer(ODOMETRY_NS, self._publish)

    def _publish(self) -> None:
        angles, speeds = self._measure()
        data = self._bytes.data(*self.stamp, angles, speeds)
        self._publisher.publish(_joint_state(self.now_ns, angles, speeds), data)


def _joint_state(time_ns: int, angles: Wheels, speeds: Wheels) -> Any:
    return _JointState(header(time_ns, ""), _JOINTS, np.array(angles), np.array(speeds), _NO_EFFORT)
