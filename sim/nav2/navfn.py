"""NavFn: a wavefront of travel costs over a costmap, and the descent along it.

Cost translation, interpolation between cells and the half-cell descent are those of Nav2's NavFn
planner with Dijkstra's expansion and unknown space allowed. Action and topic are in
``planner_server``.
"""

import math

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit, jit_unchecked
from sim.nav2.costmap import INSCRIBED, NO_INFORMATION, Costmap2D, Costs, Points

TOLERANCE = 0.5  # how far from an unreachable goal a path may end, along each axis [m]
NEUTRAL = 50.0  # cost of a free cell
FACTOR = 0.8  # factor of the costmap's cost, added to it
OBSTACLE = 254.0  # cells of this cost are never entered
STEP = 0.5  # of the descent [cells]

CellValues = NDArray[np.float64]


def _translation() -> Costs:
    """Return NavFn's cost of a cell, a whole number, by its cost in the costmap."""
    table = np.full(256, OBSTACLE)
    table[:INSCRIBED] = np.minimum(np.floor(NEUTRAL + FACTOR * np.arange(INSCRIBED)), OBSTACLE - 1)
    table[NO_INFORMATION] = OBSTACLE - 1
    return table.astype(np.uint8)


_TRANSLATION = _translation()


def plan(
    grid: Costmap2D,
    start_xy: tuple[float, float],
    goal_xy: tuple[float, float],
    tolerance: float = TOLERANCE,
) -> Points | None:
    """Return the cheapest path between two points.

    Parameters
    ----------
    grid
        An inflated costmap.
    start_xy, goal_xy
        In the grid's frame [m].
    tolerance
        If the goal cannot be reached, the path ends at the nearest point that can be, at most
        this far away along each axis [m].

    Returns
    -------
    ndarray of shape (n, 2) or None
        Points half a cell apart, the last of them the goal [m]. None if there is no path, or an
        end lies off the grid.
    """
    if not (grid.contains(*start_xy) and grid.contains(*goal_xy)):
        return None
    cells = cell_costs(grid)
    seed, goal = grid.cell(*start_xy), grid.cell(*goal_xy)
    potential = wavefront(cells, seed[0], seed[1], goal[0], goal[1])
    end_xy: tuple[float, float] | None = goal_xy
    if potential[goal[1], goal[0]] == math.inf:
        end_xy = _nearest_reachable(grid, potential, goal_xy, tolerance)
    if end_xy is None:
        return None
    end = grid.cell(*end_xy)
    path = _descend(potential, end[0], end[1], seed[0], seed[1])
    if not len(path):
        return None
    corner = np.array([grid.origin_x, grid.origin_y])
    points = corner + (path[::-1] + 0.5) * grid.resolution
    return _approach(points, np.array(end_xy))


def cell_costs(grid: Costmap2D) -> Costs:
    """Return what entering each cell costs NavFn; the border of the grid is an obstacle."""
    cells: Costs = _TRANSLATION.take(grid.costs)
    cells[[0, -1], :] = OBSTACLE
    cells[:, [0, -1]] = OBSTACLE
    return cells


def _nearest_reachable(
    grid: Costmap2D, potential: CellValues, goal_xy: tuple[float, float], tolerance: float
) -> tuple[float, float] | None:
    """Return the reachable point nearest to a goal that is not reachable itself [m]."""
    reach = int(tolerance / grid.resolution)
    offsets = grid.resolution * np.arange(-reach, reach + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(goal_xy[0] + offsets, goal_xy[1] + offsets))
    columns = np.floor((x - grid.origin_x) / grid.resolution).astype(int)
    rows = np.floor((y - grid.origin_y) / grid.resolution).astype(int)
    height, width = potential.shape
    reachable = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    reachable[reachable] = np.isfinite(potential[rows[reachable], columns[reachable]])
    if not reachable.any():
        return None
    distance = np.hypot(x - goal_xy[0], y - goal_xy[1])
    nearest = int(np.argmin(np.where(reachable, distance, np.inf)))
    return float(x[nearest]), float(y[nearest])


def _approach(points: Points, goal: Points) -> Points:
    """Return a path that ends at the goal and not beyond it."""
    if len(points) >= 2:
        last, goal_step = points[-1] - points[-2], goal - points[-2]
        if math.hypot(*last) >= math.hypot(*goal_step):
            points = points[:-1]
    return np.vstack([points, goal])


@jit_unchecked
def wavefront(
    cells: Costs, start_column: int, start_row: int, goal_column: int, goal_row: int
) -> CellValues:
    """Return the cost of travel from the start to every cell.

    Cells are expanded in bands of cost; the wave stops with the band that settles the goal, so
    what lies beyond may not be final, and what no path reaches is infinite.
    """
    height, width = cells.shape
    cost = cells.ravel()
    potential = np.full(cost.size, np.inf)
    goal = goal_row * width + goal_column
    steps = (-1, 1, -width, width)
    # A cell waits in at most one of the three lists.
    waiting = np.zeros(cost.size, np.bool_)
    current = np.empty(cost.size, np.int64)
    following = np.empty(cost.size, np.int64)
    beyond = np.empty(cost.size, np.int64)
    n_current = n_following = n_beyond = 0

    start = start_row * width + start_column
    potential[start] = 0.0
    if 0 < start_row < height - 1 and 0 < start_column < width - 1:
        for step in steps:
            if cost[start + step] < OBSTACLE:
                current[n_current] = start + step
                waiting[start + step] = True
                n_current += 1

    threshold = OBSTACLE
    while n_current > 0:
        for i in range(n_current):
            waiting[current[i]] = False
        for i in range(n_current):
            cell = current[i]
            beside = min(potential[cell - 1], potential[cell + 1])
            above = min(potential[cell - width], potential[cell + width])
            lower, slope = min(beside, above), abs(beside - above) / cost[cell]
            share = 1.0
            if slope < 1.0:  # the wave comes in at an angle: NavFn's quadratic fit
                share = (0.5307 - 0.2301 * slope) * slope + 0.7040
            arrival = lower + share * cost[cell]
            if arrival >= potential[cell]:
                continue
            potential[cell] = arrival
            for step in steps:
                neighbour = cell + step
                if waiting[neighbour] or cost[neighbour] >= OBSTACLE:
                    continue
                if potential[neighbour] <= arrival + 0.7071 * cost[neighbour]:
                    continue
                waiting[neighbour] = True
                if arrival < threshold:
                    following[n_following] = neighbour
                    n_following += 1
                else:
                    beyond[n_beyond] = neighbour
                    n_beyond += 1
        current, following = following, current
        n_current, n_following = n_following, 0
        if n_current == 0:
            if potential[goal] < threshold:
                break
            current, beyond = beyond, current
            n_current, n_beyond = n_beyond, 0
            threshold += 2.0 * NEUTRAL
    return potential.reshape(height, width)


@jit
def _descend(
    potential: CellValues, column: int, row: int, start_column: int, start_row: int
) -> Points:
    """Return the descent to the start, shape (n, 2): column, row; empty if stuck.

    A step follows the gradient between the four cells around. Beside a cell that was never
    reached, where there is no gradient, and where steps repeat, it goes to the lowest neighbour.
    """
    limit = 4 * max(potential.shape)
    path = np.empty((limit + 1, 2))
    x, y = float(column), float(row)
    for n in range(limit):
        path[n, 0], path[n, 1] = x, y
        if abs(x - start_column) <= 1.0 and abs(y - start_row) <= 1.0:
            path[n + 1, 0], path[n + 1, 1] = start_column, start_row
            return path[: n + 2]
        nearest_row, nearest_column = round(y), round(x)
        lowest_row, lowest_column = nearest_row, nearest_column
        all_known = True
        for r in range(nearest_row - 1, nearest_row + 2):
            for c in range(nearest_column - 1, nearest_column + 2):
                all_known = all_known and potential[r, c] < np.inf
                if potential[r, c] < potential[lowest_row, lowest_column]:
                    lowest_row, lowest_column = r, c
        slope_x = slope_y = 0.0
        repeats = n > 1 and x == path[n - 2, 0] and y == path[n - 2, 1]
        if all_known and not repeats:
            left, below = int(np.floor(x)), int(np.floor(y))
            for i in range(2):
                for j in range(2):
                    share = (1.0 - abs(x - left - j)) * (1.0 - abs(y - below - i))
                    if share > 0.0:
                        down_x, down_y = _downhill(potential, left + j, below + i)
                        slope_x += share * down_x
                        slope_y += share * down_y
        norm = np.hypot(slope_x, slope_y)
        if norm > 0.0:
            x += STEP * slope_x / norm
            y += STEP * slope_y / norm
        else:
            x, y = float(lowest_column), float(lowest_row)
    return path[:0]


@jit
def _downhill(potential: CellValues, column: int, row: int) -> tuple[float, float]:
    """Return the unit vector down the potential at a cell, from the neighbours that are known."""
    here = potential[row, column]
    x = _difference(potential[row, column - 1], here, potential[row, column + 1])
    y = _difference(potential[row - 1, column], here, potential[row + 1, column])
    norm = np.hypot(x, y)
    if norm == 0.0:
        return 0.0, 0.0
    return x / norm, y / norm


@jit
def _difference(before: float, here: float, after: float) -> float:
    """Return the fall of the potential along an axis; neighbours it never reached do not count."""
    fall = 0.0
    if before < np.inf:
        fall += before - here
    if after < np.inf:
        fall += here - after
    return fall
