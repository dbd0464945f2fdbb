"""The map of an arena as an occupancy grid, and the frames in it.

It resembles the map that Nav2 ships for turtlebot3_world, which was made by SLAM: walls are one or
two cells thick, cells that no ray reached are unknown, and the map is rotated and shifted slightly
against the world. Figures: docs/explanation/world.md.
"""

import functools
import math

import numpy as np
from scipy import ndimage

from sim.campaigns import OdometrySource
from sim.middleware.geometry import Pose2D
from sim.nav2.map_server import OccupancyMap
from sim.turtlebot3.arena import Arena

RESOLUTION_M = 0.05
CELLS = 384  # a side
ORIGIN_M = -10.0  # of both axes
MARGIN_M = 0.5  # of the map of a drawn arena, around its walls

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/msg/OccupancyGrid

# The bias of the original, fitted over its nine cylinders.
WORLD_IN_MAP = Pose2D(0.030, -0.002, math.radians(-1.05))

# SLAM marks a wall in all cells whose centres are this far in front of and behind its surface.
_BEFORE_M, _BEHIND_M = 0.025, 0.065


# A campaign uses its arenas block by block.
@functools.lru_cache(maxsize=8)
def occupancy_map(arena: Arena) -> OccupancyMap:
    """Return the map of an arena without additional obstacles; treat it as read-only."""
    origin, (width, height) = _extent(arena)
    x, y = (
        o + RESOLUTION_M * (np.arange(n) + 0.5)
        for o, n in zip(origin, (width, height), strict=True)
    )
    centres = np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])
    distance = arena.clearance(WORLD_IN_MAP.inverse().apply(centres)).reshape(height, width)
    reachable = distance > 0.0
    seen = ndimage.binary_dilation(reachable, np.ones((5, 5), int))  # within two cells
    data = np.full((height, width), UNKNOWN, np.int8)
    data[reachable] = FREE
    data[seen & (distance <= _BEFORE_M) & (distance > -_BEHIND_M)] = OCCUPIED
    data.flags.writeable = False
    return OccupancyMap(data, RESOLUTION_M, origin)


def _extent(arena: Arena) -> tuple[tuple[float, float], tuple[int, int]]:
    """Return the outer corner of cell (0, 0) [m], and the numbers of cells along x and y."""
    if arena.kind == "hexagon":  # as in the original, most of which is unknown
        return (ORIGIN_M, ORIGIN_M), (CELLS, CELLS)
    reach = np.array(arena.boundary.reach) + MARGIN_M
    corners = WORLD_IN_MAP.apply(np.array([(i, j) for i in (-1, 1) for j in (-1, 1)]) * reach)
    cells = np.ceil(np.abs(corners).max(axis=0) / RESOLUTION_M).astype(int).tolist()
    origin = (-RESOLUTION_M * cells[0], -RESOLUTION_M * cells[1])
    return origin, (2 * cells[0], 2 * cells[1])


def odom_in_map(source: OdometrySource, start: Pose2D) -> Pose2D:
    """Return the pose of the odometry frame in the map frame before odometry has drifted.

    Parameters
    ----------
    source
        Of the odometry.
    start
        Of the robot, in the map frame.
    """
    return start if source == "encoder" else WORLD_IN_MAP
