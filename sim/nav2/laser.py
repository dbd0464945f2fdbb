"""Laser scans as points, the way ``laser_geometry`` projects them."""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    seen = (ranges >= scan.range_min) & (ranges < scan.range_max)
    bearings = _bearings(scan.angle_min, scan.angle_increment, ranges.size)
    points: NDArray[np.float64] = ranges[seen, np.newaxis] * bearings[seen]
    return points


@functools.lru_cache(maxsize=16)
def _bearings(angle_min: float, increment: float, count: int) -> NDArray[np.float64]:
    """Return unit vectors along the beams, shape (count, 2)."""
    angles = angle_min + increment * np.arange(count)
    return np.column_stack([np.cos(angles), np.sin(angles)])
