"""The messages of the local costmap's voxel layer, as CDR bytes."""

import struct

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware.executor import SECOND
from sim.middleware.stamps import header
from sim.nav2.costmap import FREE_SPACE, LETHAL, Costmap2D, Costs, Points

VOXELS = "nav2_msgs/msg/VoxelGrid"
CLOUD = "sensor_msgs/msg/PointCloud2"

_Point32 = message_class("geometry_msgs/msg/Point32")
_PointCloud2 = message_class(CLOUD)
_PointField = message_class("sensor_msgs/msg/PointField")
_Vector3 = message_class("geometry_msgs/msg/Vector3")
_VoxelGrid = message_class(VOXELS)

_LEVELS = 16
_LEVEL_HEIGHT = 0.05  # [m]
_LASER_Z = 0.132  # of the scan plane above the ground [m], by the robot's URDF
_LASER_LEVEL = int(_LASER_Z / _LEVEL_HEIGHT)

_POINT_STEP = 12  # bytes of three float32


class VoxelGrids:
    """``nav2_msgs/msg/VoxelGrid``: bits z and z + 16 hold the state of level z.

    Both set: marked. The lower one alone: unknown. None: free.

    Parameters
    ----------
    grid
        Its frame, size and resolution.
    """

    def __init__(self, grid: Costmap2D) -> None:
        height, width = grid.costs.shape
        message = _VoxelGrid(
            header(0, grid.frame), np.zeros(height * width, np.uint32), _Point32(0.0, 0.0, 0.0),
            _Vector3(grid.resolution, grid.resolution, _LEVEL_HEIGHT), width, height, _LEVELS,
        )  # fmt: skip
        self._template = Template(message, VOXELS, (*STAMP, "data", "origin"))

    def data(self, time_ns: int, grid: Costmap2D, seen: Costs) -> bytes:
        """Return the message of what lasers saw in the grid's cells."""
        origin = (grid.origin_x, grid.origin_y, 0.0)
        return self._template.data(*divmod(time_ns, SECOND), _columns(seen), origin)


@jit
def _columns(seen: Costs) -> NDArray[np.uint32]:
    """Return the voxels of each cell's column, row by row."""
    unknown = np.uint32((1 << _LEVELS) - 1)
    free = unknown & ~np.uint32(1 << _LASER_LEVEL)
    marked = unknown | np.uint32(1 << (_LASER_LEVEL + _LEVELS))
    columns = np.empty(seen.size, np.uint32)
    for i, cost in enumerate(seen.flat):
        columns[i] = free if cost == FREE_SPACE else marked if cost == LETHAL else unknown
    return columns


class LaserClouds:
    """``sensor_msgs/msg/PointCloud2`` of points in the laser's plane.

    Parameters
    ----------
    frame
        Frame id of the points.
    """

    def __init__(self, frame: str) -> None:
        fields = [_PointField(name, 4 * i, _PointField.FLOAT32, 1) for i, name in enumerate("xyz")]
        empty = _PointCloud2(
            header(0, frame), 1, 0, fields, False, _POINT_STEP, 0, np.zeros(0, np.uint8), True
        )
        self._template = Template(empty, CLOUD, (*STAMP, "width"))

    def data(self, time_ns: int, points: Points) -> bytes:
        """Return the message of points of shape (n, 2) [m]."""
        size = _POINT_STEP * len(points)
        empty = self._template.data(*divmod(time_ns, SECOND), len(points))
        # It ends with the length of a row, that of the data, no data, and is_dense.
        return b"".join((empty[:-9], struct.pack("<II", size, size), _in_plane(points).data,
                         empty[-1:]))  # fmt: skip


@jit
def _in_plane(points: Points) -> NDArray[np.float32]:
    """Return points of shape (n, 2) in the laser's plane, shape (n, 3) [m]."""
    xyz = np.empty((len(points), 3), np.float32)
    for i in range(len(points)):
        xyz[i, 0], xyz[i, 1], xyz[i, 2] = points[i, 0], points[i, 1], _LASER_Z
    return xyz
