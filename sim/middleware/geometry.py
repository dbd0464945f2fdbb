"""Planar rigid transforms (REP 103: x forward, y left, yaw counter-clockwise; m, rad)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats


def wrap_angle(angle: float) -> float:
    """Return the same direction in [-pi, pi) [rad]."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


wrapped = jit(wrap_angle)  # for compiled code


@dataclass(frozen=True, slots=True)
class Pose2D:
    """A planar pose, or the transform that takes its coordinates into the parent frame."""

    x: float = 0.0  # [m]
    y: float = 0.0  # [m]
    yaw: float = 0.0  # [rad]

    def compose(self, other: "Pose2D") -> "Pose2D":
        """Return ``other``, given in this frame, in the parent frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.yaw + other.yaw),
        )

    def inverse(self) -> "Pose2D":
        """Return the parent frame's pose in this frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.yaw))

    def apply(self, points: Floats) -> Floats:
        """Take points of shape (n, 2) from this frame into the parent frame [m]."""
        return _moved(points, self.x, self.y, math.cos(self.yaw), math.sin(self.yaw))

    def distance_to(self, other: "Pose2D") -> float:
        """Return the straight distance to ``other`` in the same frame [m]."""
        return math.hypot(self.x - other.x, self.y - other.y)


Planar = tuple[float, float, float]
"""A `Pose2D` in compiled code: x, y [m], yaw [rad]."""


@jit
def composed(upper: Planar, lower: Planar) -> Planar:
    """Return what `Pose2D.compose` does, operation by operation."""
    (x, y, yaw), (ahead, aside, turn) = upper, lower
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * ahead - s * aside, y + s * ahead + c * aside, wrapped(yaw + turn)


@jit
def inverted(pose: Planar) -> Planar:
    """Return what `Pose2D.inverse` does, operation by operation."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return -c * x - s * y, s * x - c * y, wrapped(-yaw)


@jit
def _moved(points: Floats, x: float, y: float, c: float, s: float) -> Floats:
    moved = np.empty(points.shape)
    for i in range(len(points)):
        moved[i, 0] = x + c * points[i, 0] - s * points[i, 1]
        moved[i, 1] = y + s * points[i, 0] + c * points[i, 1]
    return moved


def quaternion_yaw(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw of a unit quaternion [rad]."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def pose_yaw(pose: Any) -> float:
    """Return the yaw of ``geometry_msgs/msg/Pose`` [rad]."""
    q = pose.orientation
    return quaternion_yaw(q.x, q.y, q.z, q.w)


def yaw_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation about z."""
    return 0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)
