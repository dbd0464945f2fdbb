"""Laser scans as points, the way ``laser_geometry`` projects them."""

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats
from sim.middleware.geometry import Pose2D


def scan_points(scan: Any, sensor: Pose2D) -> Floats:
    """Return where the beams of a scan ended.

    Parameters
    ----------
    scan
        ``sensor_msgs/msg/LaserScan``. Readings that are NaN, infinite, below ``range_min`` or
        not below ``range_max`` saw nothing and yield no point.
    sensor
        Pose of the sensor in the frame of the points.

    Returns
    -------
    ndarray of shape (n_valid, 2)
        [m].
    """
    pose = (sensor.x, sensor.y, math.cos(sensor.yaw), math.sin(sensor.yaw))
    return _projected(scan.ranges, beam_bearings(scan), scan.range_min, scan.range_max, pose)


def beam_bearings(scan: Any) -> Floats:
    """Return unit vectors along the beams of a scan, in the sensor frame, shape (n, 2)."""
    return _bearings(scan.angle_min, scan.angle_increment, len(scan.ranges))


@jit
def _projected(
    ranges: NDArray[np.float32],
    bearings: Floats,
    range_min: float,
    range_max: float,
    pose: tuple[float, float, float, float],
) -> Floats:
    sensor_x, sensor_y, c, s = pose
    points = np.empty(bearings.shape)
    count = 0
    for i in range(len(ranges)):
        if range_min <= ranges[i] < range_max:
            x = np.float64(ranges[i]) * bearings[i, 0]
            y = np.float64(ranges[i]) * bearings[i, 1]
            points[count, 0] = sensor_x + c * x - s * y
            points[count, 1] = sensor_y + s * x + c * y
            count += 1
    return points[:count]


@functools.lru_cache(maxsize=16)
def _bearings(angle_min: float, increment: float, count: int) -> Floats:
    with np.errstate(invalid="ignore", over="ignore"):  # an attacked scan may have any angles
        angles = angle_min + increment * np.arange(count)
        return np.column_stack([np.cos(angles), np.sin(angles)])
