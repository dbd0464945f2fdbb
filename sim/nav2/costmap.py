"""A grid of costs: its values, functions to read it, and its two messages.

What fills the grid is in ``costmap_layers``, the node that publishes it in ``costmap_node``.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.types import message_class
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import header, time_message
from sim.nav2.footprint import FOOTPRINT
from sim.nav2.messages import pose_message

FREE_SPACE = 0
INSCRIBED = 253  # the robot's centre cannot be here
LETHAL = 254  # an obstacle is here
NO_INFORMATION = 255

Costs = NDArray[np.uint8]
Points = NDArray[np.float64]

COSTMAP = "nav2_msgs/msg/Costmap"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"

_Costmap = message_class(COSTMAP)
_CostmapMetaData = message_class("nav2_msgs/msg/CostmapMetaData")
_MapMetaData = message_class("nav_msgs/msg/MapMetaData")
_OccupancyGrid = message_class(OCCUPANCY_GRID)

# Cost to occupancy: 0 stays, 1..252 become 1..98, inscribed 99, lethal 100, unknown -1.
_OCCUPANCY = np.array(
    [0, *(1 + 97 * (cost - 1) // 251 for cost in range(1, INSCRIBED)), 99, 100, -1], np.int8
)


class CostGrid(NamedTuple):
    """A costmap as compiled code takes it."""

    costs: Costs  # shape (rows, columns); row 0 has the smallest y
    resolution: float  # [m]
    origin_x: float  # of the lower left corner [m]
    origin_y: float


@dataclass(slots=True)
class Costmap2D:
    """Costs of the cells of an axis-aligned rectangle.

    Attributes
    ----------
    costs
        Shape (height, width); row and column 0 lie at the origin.
    resolution
        Edge of a cell [m].
    origin_x, origin_y
        Outer corner of cell (0, 0) in ``frame`` [m].
    frame
        Frame id of the origin.
    """

    costs: Costs
    resolution: float
    origin_x: float
    origin_y: float
    frame: str

    @classmethod
    def from_message(cls, message: Any) -> "Costmap2D":
        """Return the grid in a ``nav2_msgs/msg/Costmap``; it shares the message's memory."""
        meta = message.metadata
        return cls(
            message.data.reshape(meta.size_y, meta.size_x),
            meta.resolution,
            meta.origin.position.x,
            meta.origin.position.y,
            message.header.frame_id,
        )

    @property
    def cost_grid(self) -> CostGrid:
        """The grid as compiled code takes it; it shares the costs."""
        return CostGrid(self.costs, self.resolution, self.origin_x, self.origin_y)

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point [m] lies on the grid."""
        column, row = self.cell(x, y)
        height, width = self.costs.shape
        return bool(0 <= row < height and 0 <= column < width)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return (column, row) of the cell a point [m] lies in, on the grid or off it."""
        return (
            math.floor((x - self.origin_x) / self.resolution),
            math.floor((y - self.origin_y) / self.resolution),
        )


# -- reading -------------------------------------------------------------------------------


@jit
def _cost_at(grid: CostGrid, x: float, y: float) -> int:
    """Return the cost under a point [m]; unknown (255) off the grid."""
    costs, resolution, origin_x, origin_y = grid
    column = int(np.floor((x - origin_x) / resolution))
    row = int(np.floor((y - origin_y) / resolution))
    if row < 0 or column < 0 or row >= costs.shape[0] or column >= costs.shape[1]:
        return 255
    return int(costs[row, column])


@jit
def _polygon_cost(grid: CostGrid, polygon: Points) -> int:
    """Return the highest cost under the edges of a polygon of shape (n, 2) [m].

    An edge is sampled at the rate of Bresenham's line: once per cell along its longer axis.
    """
    highest = 0
    for i in range(polygon.shape[0]):
        x, y = polygon[i]
        to_x, to_y = polygon[(i + 1) % polygon.shape[0]]
        steps = int(np.ceil(max(abs(to_x - x), abs(to_y - y)) / grid.resolution)) + 1
        for step in range(steps):
            share = step / steps
            cost = _cost_at(grid, x + share * (to_x - x), y + share * (to_y - y))
            highest = max(highest, cost)
    return highest


def footprint_cost(grid: Costmap2D, pose: Pose2D, footprint: Points = FOOTPRINT) -> int:
    """Return the highest cost under the outline of a robot at ``pose``; from 254 on it collides."""
    return _polygon_cost(grid.cost_grid, pose.apply(footprint))


# -- messages ------------------------------------------------------------------------------


def occupancies(grid: Costmap2D) -> NDArray[np.int8]:
    """Return the costs as occupancies of shape (height, width) [%], for display."""
    return _occupancies(grid.costs, _OCCUPANCY)


@jit
def _occupancies(costs: Costs, by_cost: NDArray[np.int8]) -> NDArray[np.int8]:
    occupancies = np.empty(costs.shape, np.int8)
    for row in range(costs.shape[0]):
        for column in range(costs.shape[1]):
            occupancies[row, column] = by_cost[costs[row, column]]
    return occupancies


def occupancy_grid(time_ns: int, grid: Costmap2D) -> Any:
    """Return the costs as ``nav_msgs/msg/OccupancyGrid``."""
    return occupancy_grid_message(
        time_ns, grid.frame, occupancies(grid), grid.resolution, grid.origin_x, grid.origin_y
    )


def occupancy_grid_message(
    time_ns: int,
    frame: str,
    data: NDArray[np.int8],
    resolution: float,
    origin_x: float,
    origin_y: float,
) -> Any:
    """Return ``nav_msgs/msg/OccupancyGrid`` of occupancies of shape (height, width) [%]."""
    height, width = data.shape
    origin = pose_message(origin_x, origin_y, 0.0)
    meta = _MapMetaData(time_message(0), resolution, width, height, origin)
    return _OccupancyGrid(header(time_ns, frame), meta, data.ravel())


def costmap_message(time_ns: int, grid: Costmap2D) -> Any:
    """Return a copy of the costs as ``nav2_msgs/msg/Costmap``, for other nodes to plan with."""
    height, width = grid.costs.shape
    zero = time_message(0)  # Nav2 leaves both times of the metadata at zero
    origin = pose_message(grid.origin_x, grid.origin_y, 0.0)
    meta = _CostmapMetaData(zero, zero, "master", grid.resolution, width, height, origin)
    return _Costmap(header(time_ns, grid.frame), meta, grid.costs.flatten())
