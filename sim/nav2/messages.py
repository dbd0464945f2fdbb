"""Messages of planar poses and velocities, which several nodes build."""

import struct
from typing import Any

from oracle_pipeline.bags.cdr import ENCAPSULATION
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats
from sim.middleware.geometry import Pose2D, yaw_quaternion
from sim.middleware.stamps import header

TWIST = "geometry_msgs/msg/Twist"
POSE_ESTIMATE = "geometry_msgs/msg/PoseWithCovarianceStamped"

_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_PoseEstimate = message_class(POSE_ESTIMATE)
_PoseStamped = message_class("geometry_msgs/msg/PoseStamped")
_PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Twist = message_class(TWIST)
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_pack_twist = struct.Struct("<4s6d").pack


def twist_message(linear: float, angular: float) -> Any:
    """Return ``geometry_msgs/msg/Twist`` of a robot that cannot move sideways [m/s, rad/s]."""
    return _Twist(_Vector3(linear, 0.0, 0.0), _Vector3(0.0, 0.0, angular))


def twist_bytes(linear: float, angular: float) -> bytes:
    """Return the bytes of ``serialize(twist_message(...))``, in less time."""
    return _pack_twist(ENCAPSULATION, linear, 0.0, 0.0, 0.0, 0.0, angular)


def pose_message(x: float, y: float, yaw: float) -> Any:
    """Return ``geometry_msgs/msg/Pose`` of a planar pose."""
    return _Pose(_Point(x, y, 0.0), _Quaternion(*yaw_quaternion(yaw)))


def pose_stamped(time_ns: int, frame: str, x: float, y: float, yaw: float) -> Any:
    """Return ``geometry_msgs/msg/PoseStamped`` of a planar pose."""
    return _PoseStamped(header(time_ns, frame), pose_message(x, y, yaw))


def pose_estimate(time_ns: int, pose: Pose2D, covariance: Floats) -> Any:
    """Return ``geometry_msgs/msg/PoseWithCovarianceStamped`` in the map frame.

    ``covariance`` is that of x, y, z, roll, pitch and yaw, shape (36,).
    """
    where = _PoseWithCovariance(pose_message(pose.x, pose.y, pose.yaw), covariance)
    return _PoseEstimate(header(time_ns, "map"), where)
