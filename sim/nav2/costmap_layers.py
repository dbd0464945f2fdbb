"""The layers that fill a costmap: obstacles seen by lasers, and the static map.

Pure functions of grids and points; what is added around obstacles is in ``inflation``, transforms,
topics and timers are in ``costmap_node``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from sim.nav2.costmap import FREE_SPACE, LETHAL, NO_INFORMATION, CostGrid, Costmap2D, Costs, Points

OBSTACLE_RANGE = 2.5  # nothing is marked beyond [m]
RAYTRACE_RANGE = 3.0  # nothing is cleared beyond [m]
_TINY = 1e-9  # instead of a length of zero [m]


@dataclass(frozen=True, slots=True)
class Observation:
    """One measurement of a sensor, in the costmap's frame."""

    stamp_ns: int
    x: float  # of the sensor [m]
    y: float  # of the sensor [m]
    points: Points  # (n, 2), where its beams ended [m]


class ObstacleLayer:
    """Obstacles that sensors measure, and the free space in front of them.

    Parameters
    ----------
    grid
        Geometry of the layer; its costs are not used.
    margin
        Clearing stops this far before what a beam hit [m]: nothing in Nav2's obstacle layer,
        two cells in its voxel layer.

    Attributes
    ----------
    costs
        Free, lethal, or unknown where no beam has been; as large as the grid.
    """

    def __init__(self, grid: Costmap2D, *, margin: float = 0.0) -> None:
        self.costs = np.full_like(grid.costs, NO_INFORMATION)
        self._margin = margin

    def reset(self) -> None:
        """Clear the layer."""
        self.costs[:] = NO_INFORMATION

    def update(
        self, grid: Costmap2D, observations: Sequence[Observation], footprint: Points
    ) -> list[Points]:
        """Clear along all beams, then mark where they ended, then clear under the robot.

        Returns how far the beams of each observation cleared, arrays of shape (n, 2) [m].
        """
        layer = grid.cost_grid._replace(costs=self.costs)
        ends = [_clear(layer, s.x, s.y, s.points, self._margin) for s in observations]
        for seen in observations:
            _mark(layer, seen.x, seen.y, seen.points)
        _fill_convex(layer, footprint)
        return ends

    def add_to(self, costs: Costs) -> None:
        """Raise ``costs`` to those of this layer, except where it is unknown."""
        _raise(costs, self.costs)


@jit
def _raise(costs: Costs, seen: Costs) -> None:
    height, width = costs.shape
    for row in range(height):
        for column in range(width):
            cost, here = costs[row, column], seen[row, column]
            is_higher = (cost == NO_INFORMATION) | (here > cost)
            costs[row, column] = here if (here != NO_INFORMATION) & is_higher else cost


@jit
def shift(costs: Costs, columns: int, rows: int, fill: int) -> Costs:
    """Return a grid's content after its origin moved by whole cells; new cells hold ``fill``."""
    height, width = costs.shape
    moved = np.full(costs.shape, np.uint8(fill), np.uint8)
    for row in range(max(0, -rows), min(height, height - rows)):
        for column in range(max(0, -columns), min(width, width - columns)):
            moved[row, column] = costs[row + rows, column + columns]
    return moved


def static_costs(occupancy: NDArray[np.int8]) -> Costs:
    """Return a map's occupancies as costs (Nav2's trinary mode, unknown space tracked)."""
    costs: Costs = np.where(occupancy >= 100, LETHAL, FREE_SPACE).astype(np.uint8)
    costs[occupancy < 0] = NO_INFORMATION
    return costs


@jit
def _clear(
    grid: CostGrid, sensor_x: float, sensor_y: float, points: Points, margin: float
) -> Points:
    """Free the cells along every beam; return how far each cleared, shape (n, 2) [m]."""
    costs, resolution, origin_x, origin_y = grid
    height, width = costs.shape
    # Slightly inside, so that the end of a beam at the far border still has a cell.
    right = origin_x + resolution * (width - 1e-6)
    top = origin_y + resolution * (height - 1e-6)
    ends = _ends((origin_x, origin_y, right, top), sensor_x, sensor_y, points, margin)
    from_x = (sensor_x - origin_x) / resolution
    from_y = (sensor_y - origin_y) / resolution
    if 0.0 <= from_x < width and 0.0 <= from_y < height:
        cells, column, row = costs.ravel(), int(from_x), int(from_y)
        before_x, before_y = -1, -1
        for i in range(len(ends)):
            along, up = (ends[i, 0] - origin_x) / resolution, (ends[i, 1] - origin_y) / resolution
            if not (-1.0 < along < width and -1.0 < up < height):  # NaN, from a false scan
                continue
            end_x, end_y = int(along), int(up)
            if end_x != before_x or end_y != before_y:  # else as the beam beside it
                _free_line(cells, width, row * width + column, end_x - column, end_y - row)
            before_x, before_y = end_x, end_y
    return ends


@jit
def _ends(
    box: tuple[float, float, float, float],
    sensor_x: float,
    sensor_y: float,
    points: Points,
    margin: float,
) -> Points:
    """Return how far beams clear: short of their hits, in range, in a box, shape (n, 2) [m]."""
    left, bottom, right, top = box
    ends = np.empty(points.shape)
    for i in range(len(points)):
        x, y = points[i, 0] - sensor_x, points[i, 1] - sensor_y
        distance = math.hypot(x, y)
        share = min(max(distance - margin, 0.0), RAYTRACE_RANGE) / max(distance, _TINY)
        to_x = (right - sensor_x if x > 0.0 else sensor_x - left) / max(abs(x), _TINY)
        to_y = (top - sensor_y if y > 0.0 else sensor_y - bottom) / max(abs(y), _TINY)
        share = min(share, max(min(to_x, to_y), 0.0))
        ends[i, 0] = sensor_x + share * x
        ends[i, 1] = sensor_y + share * y
    return ends


@jit
def _free_line(cells: Costs, width: int, start: int, columns: int, rows: int) -> None:
    """Free the cells from one to another, one a step along the longer axis.

    Parameters
    ----------
    cells
        Of a grid, row by row, shape (height * width,).
    width
        Of the grid [cells].
    start
        Index of the first cell.
    columns, rows
        From the first cell to the last.
    """
    if abs(columns) >= abs(rows):
        steps, along = abs(columns), np.sign(columns)
        across, aside = rows, width
    else:
        steps, along = abs(rows), np.sign(rows) * width
        across, aside = columns, 1
    for step in range(steps + 1):
        share = step / max(steps, 1)
        # Unsigned, as an index that cannot count from the end is looked up faster.
        cells[np.uint64(start + step * along + round(share * across) * aside)] = FREE_SPACE


@jit
def _mark(grid: CostGrid, sensor_x: float, sensor_y: float, points: Points) -> None:
    """Make the cells of all points in range lethal."""
    costs, resolution, origin_x, origin_y = grid
    height, width = costs.shape
    for i in range(points.shape[0]):
        x, y = points[i]
        if np.hypot(x - sensor_x, y - sensor_y) >= OBSTACLE_RANGE:
            continue
        column = int(np.floor((x - origin_x) / resolution))
        row = int(np.floor((y - origin_y) / resolution))
        if 0 <= row < height and 0 <= column < width:
            costs[row, column] = LETHAL


@jit
def _fill_convex(grid: CostGrid, polygon: Points) -> None:
    """Free the cells whose centre lies in a convex, counter-clockwise polygon."""
    costs, resolution, origin_x, origin_y = grid
    height, width = costs.shape
    cells_x = (polygon[:, 0] - origin_x) / resolution
    cells_y = (polygon[:, 1] - origin_y) / resolution
    for row in range(max(0, int(cells_y.min())), min(height, int(cells_y.max()) + 1)):
        for column in range(max(0, int(cells_x.min())), min(width, int(cells_x.max()) + 1)):
            inside = True
            for i in range(polygon.shape[0]):
                j = (i + 1) % polygon.shape[0]
                cross = (cells_x[j] - cells_x[i]) * (row + 0.5 - cells_y[i]) - (
                    cells_y[j] - cells_y[i]
                ) * (column + 0.5 - cells_x[i])
                inside = inside and cross >= 0.0
            if inside:
                costs[row, column] = FREE_SPACE
