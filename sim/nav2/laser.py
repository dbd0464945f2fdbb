"""Laser scans as points, the way ``laser_geometry`` projects them."""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit


def scan_points(scan: Any) -> NDArray[np.float64]:
    """Return where the beams of a scan ended.

    Parameters
    ----------
    scan
        ``sensor_msgs/msg/LaserScan``. Readings that are NaN, infinite, below ``range_min`` or
        not below ``range_max`` saw nothing and yield no point.

    Returns
    -------
    ndarray of shape (n_valid, 2)
        In the sensor frame [m].
    """
    bearings = _bearings(scan.angle_min, scan.angle_increment, len(scan.ranges))
    return _projected(scan.ranges, bearings, scan.range_min, scan.range_max)


@jit
def _projected(
    ranges: NDArray[np.float32],
    bearings: NDArray[np.float64],
    range_min: float,
    range_max: float,
) -> NDArray[np.float64]:
    points = np.empty(bearings.shape)
    count = 0
    for i in range(len(ranges)):
        if range_min <= ranges[i] < range_max:
            points[count, 0] = np.float64(ranges[i]) * bearings[i, 0]
            points[count, 1] = np.float64(ranges[i]) * bearings[i, 1]
            count += 1
    return points[:count]


@functools.lru_cache(maxsize=16)
def _bearings(angle_min: float, increment: float, count: int) -> NDArray[np.float64]:
    """Return unit vectors along the beams, shape (count, 2)."""
    angles = angle_min + increment * np.arange(count)
    return np.column_stack([np.cos(angles), np.sin(angles)])
