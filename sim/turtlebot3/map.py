"""The map that Nav2 ships for this world, as an occupancy grid, and what lies where in it.

The original was made by SLAM: walls are one or two cells thick, what no ray reached is unknown,
and the whole is turned and shifted a little against the world. Figures: docs/explanation/world.md.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from sim.campaigns import OdometrySource
from sim.middleware.geometry import Pose2D
from sim.nav2.map_server import OccupancyMap
from sim.turtlebot3.arena import clearance

RESOLUTION_M = 0.05
CELLS = 384  # a side
ORIGIN_M = -10.0  # of both axes

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/msg/OccupancyGrid

# The bias of the original, fitted over its nine cylinders.
WORLD_IN_MAP = Pose2D(0.030, -0.002, math.radians(-1.05))

# SLAM smears a wall over the cells whose centres lie this far in front of and behind its surface.
_BEFORE_M, _BEHIND_M = 0.025, 0.065


@functools.cache
def turtlebot3_world_map() -> OccupancyMap:
    """Return the map of the world without additional obstacles; treat it as read-only."""
    centres = ORIGIN_M + RESOLUTION_M * (np.arange(CELLS) + 0.5)
    x, y = np.meshgrid(centres, centres)
    points = WORLD_IN_MAP.inverse().apply(np.column_stack([x.ravel(), y.ravel()]))
    distance = clearance(points).reshape(CELLS, CELLS)
    reachable = distance > 0.0  # one piece: a robot gets everywhere where there is room
    seen = _widened(reachable, 2)
    data = np.full((CELLS, CELLS), UNKNOWN, np.int8)
    data[reachable] = FREE
    data[seen & (distance <= _BEFORE_M) & (distance > -_BEHIND_M)] = OCCUPIED
    data.flags.writeable = False
    return OccupancyMap(data, RESOLUTION_M, (ORIGIN_M, ORIGIN_M))


def _widened(cells: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return the cells with at least one of ``cells`` in the square of so many cells around."""
    height, width = cells.shape
    padded = np.pad(cells, reach)
    rows = np.logical_or.reduce([padded[i : i + height] for i in range(2 * reach + 1)])
    widened: NDArray[np.bool_] = np.logical_or.reduce(
        [rows[:, i : i + width] for i in range(2 * reach + 1)]
    )
    return widened


def odom_in_map(source: OdometrySource, start: Pose2D) -> Pose2D:
    """Return where the odometry frame is in the map frame while odometry has not drifted yet.

    Parameters
    ----------
    source
        Of the odometry.
    start
        Of the robot, in the map frame.
    """
    return start if source == "encoder" else WORLD_IN_MAP
