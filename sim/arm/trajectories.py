"""Trajectories of the joints: their timing, their messages, and a collision-free path.

A path is a sequence of joint positions, between which the joints move in a straight line.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from oracle_pipeline.bags.types import message_class
from sim.arm.cell import JOINTS, RADII, spheres
from sim.arm.messages import TRAJECTORY
from sim.arrays import Floats
from sim.middleware.executor import SECOND
from sim.middleware.stamps import duration_message, header, stamp_ns

PERIOD_S, _SHORTEST_S = 0.1, 0.2  # between the points of a message; of a trajectory
# Of the joint that moves most, between places that are checked; around the arm.
_CHECKED_RAD, _MARGIN_M = 0.05, 0.015
_RAISES, _RAISE = 6, np.array([0.0, -0.25, 0.1, 0.15, 0.0, 0.0])  # lifts gripper and elbow

_JointTrajectory = message_class(TRAJECTORY)
_JointTrajectoryPoint = message_class("trajectory_msgs/msg/JointTrajectoryPoint")


class Timed(NamedTuple):
    """A trajectory."""

    times: Floats  # (n,) since its beginning [s]
    positions: Floats  # (n, 6) [rad]
    speeds: Floats  # (n, 6) [rad/s]

    def message(self, now_ns: int) -> Any:
        """Return ``trajectory_msgs/msg/JointTrajectory``."""
        none = np.zeros(0)
        points = [
            _JointTrajectoryPoint(place, speed, none, none, duration_message(round(time * SECOND)))
            for time, place, speed in zip(self.times, self.positions, self.speeds, strict=True)
        ]
        return _JointTrajectory(header(now_ns, ""), list(JOINTS), points)


def from_message(message: Any) -> CubicHermiteSpline:
    """Return the trajectory of a message, cubic between its points, the joints in our order.

    Raises
    ------
    ValueError
        If it has other joints, or no points in the order of time.
    """
    order = [message.joint_names.index(name) for name in JOINTS]
    times = [stamp_ns(point.time_from_start) / SECOND for point in message.points]
    positions, speeds = (
        np.array([getattr(point, field)[order] for point in message.points])
        for field in ("positions", "velocities")
    )
    return CubicHermiteSpline(times, positions, speeds)


def duration_s(far: float, speed: float, acceleration: float) -> float:
    """Return how long a way takes with the least jerk, from rest to rest [s]."""
    return max(1.875 * far / speed, math.sqrt(5.7735 * far / acceleration), _SHORTEST_S)


def timed(place: Callable[[float], Floats], seconds: float) -> Timed:
    """Return a trajectory with the least jerk along a path, from rest to rest.

    Parameters
    ----------
    place
        The path, from 0 to 1.
    seconds
        What it is to take.
    """
    times = np.linspace(0.0, seconds, max(math.ceil(seconds / PERIOD_S), 2) + 1)
    s = times / seconds
    done = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    positions = np.array([place(float(share)) for share in done])
    speeds = np.gradient(positions, times, axis=0)
    speeds[[0, -1]] = 0.0
    return Timed(times, positions, speeds)


def along(path: Sequence[Floats], speed: float, acceleration: float) -> Timed:
    """Return a trajectory along a path; the joint that moves most keeps both limits."""
    points = np.array(path)
    at = np.cumsum([0.0, *np.abs(np.diff(points, axis=0)).max(axis=1)])

    def place(share: float) -> Floats:
        return np.array([np.interp(share * at[-1], at, joint) for joint in points.T])

    return timed(place, duration_s(float(at[-1]), speed, acceleration))


def plan(start: Floats, goal: Floats, boxes: Floats) -> list[Floats] | None:
    """Return a path that touches no box, the first of those that lead higher and higher; or None.

    Parameters
    ----------
    start, goal
        Joints [rad].
    boxes
        What is in the way, as for `touches`.
    """
    for times in range(_RAISES):
        up = times * _RAISE
        path = [start, start + up, goal + up, goal] if times else [start, goal]
        if not any(_collides(*ends, boxes) for ends in itertools.pairwise(path)):
            return path
    return None


def touches(joints: Floats, boxes: Floats) -> bool:
    """Return whether the arm, or what it holds, touches boxes with edges along the axes.

    Parameters
    ----------
    joints
        Joints [rad].
    boxes : ndarray of shape (n, 2, 3)
        Middle and half of the edges of each [m].
    """
    away = np.abs(spheres(joints)[:, None] - boxes[:, 0]) - boxes[:, 1]
    far = (np.maximum(away, 0.0) ** 2).sum(axis=2)
    return bool((far < (RADII[:, None] + _MARGIN_M) ** 2).any())


def _collides(begin: Floats, end: Floats, boxes: Floats) -> bool:
    places = np.linspace(begin, end, 2 + int(np.abs(end - begin).max() / _CHECKED_RAD))
    return any(touches(joints, boxes) for joints in places)
