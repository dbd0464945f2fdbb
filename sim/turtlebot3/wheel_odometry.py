"""Gazebo's two sources of odometry: ``world``, the ground truth, and ``encoder``, the wheels.

This module has the second, which integrates the turns of the wheels. It drifts because of slip, and
because the wheels are 0.288 m apart but count as 0.287 m. Localisation has to correct that.
"""

import math
from collections.abc import Callable

from sim.middleware.geometry import Pose2D
from sim.turtlebot3.mjcf import WHEEL_RADIUS_M, WHEEL_SEPARATION_M

Wheels = tuple[float, float]  # of the left and the right wheel


class WheelOdometry:
    """Dead reckoning of a differential drive; the first pose is (0, 0, 0).

    Called at every update, it returns the pose of ``base_footprint`` in the odometry frame and the
    forward [m/s] and turning speed [rad/s].

    Parameters
    ----------
    measure
        Angles [rad] and speeds [rad/s] of the left and the right wheel.
    """

    def __init__(self, measure: Callable[[], tuple[Wheels, Wheels]]) -> None:
        self._measure = measure
        self._angles, _ = measure()
        self._pose = Pose2D()

    def __call__(self) -> tuple[Pose2D, tuple[float, float]]:
        """Return pose and speeds as of now."""
        angles, speeds = self._measure()
        along, turn = _motion(*(b - a for a, b in zip(self._angles, angles, strict=True)))
        self._angles = angles
        halfway = turn / 2.0  # the chord of a short arc points along its middle
        step = Pose2D(along * math.cos(halfway), along * math.sin(halfway), turn)
        self._pose = self._pose.compose(step)
        return self._pose, _motion(*speeds)


def _motion(left: float, right: float) -> tuple[float, float]:
    """Return distance and turn of the robot for turns of its wheels, or for speeds [m, rad]."""
    return (
        WHEEL_RADIUS_M * (left + right) / 2.0,
        WHEEL_RADIUS_M * (right - left) / WHEEL_SEPARATION_M,
    )
