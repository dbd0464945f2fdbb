"""DWB's seven critics, and the search for the velocity with the lowest score.

As ``dwb_critics`` on Humble. Critics that depend only on the end of a trajectory come first.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit, jit_unchecked
from sim.arrays import Floats
from sim.nav2 import dwb_sampling as sampling
from sim.nav2.costmap import CostGrid
from sim.nav2.paths import Poses

INSCRIBED = 253  # from this cost on the robot's centre must not be in a cell; 255 is unknown
UNKNOWN = 255
_BORDER = 1e-6  # this close to the edge of a cell, the sums of a rollout decide [cells]


class Cells(NamedTuple):
    """The cells of a costmap without the costs: an array takes longer to pass than to read."""

    columns: int
    rows: int
    resolution: float  # [m]
    origin_x: float  # [m]
    origin_y: float


class Critics(NamedTuple):
    """Inputs of the critics that are constant within one cycle."""

    path_distance: NDArray[np.int32]  # cells to the nearest of the path, by rows and columns
    left: int  # column and row of the first of them: they lie around the robot
    low: int
    goal_x: int  # cell of the last plan pose on the costmap
    goal_y: int
    nose_x: int  # the same for the point in front of the robot
    nose_y: int
    goal_yaw: float  # [rad]
    align_path: bool  # off close to the goal
    slowing: bool  # near the goal, still driving
    rotating: bool  # near the goal, standing
    speed_squared: float  # [m^2/s^2]
    turn: int  # 1 or -1: turn to this side only, 0: to any


@jit
def _cells_of(grid: CostGrid) -> Cells:
    rows, columns = grid.costs.shape
    return Cells(columns, rows, grid.resolution, grid.origin_x, grid.origin_y)


@jit
def _cell(cells: Cells, x: float, y: float) -> tuple[int, int]:
    """Return column and row of a point, (-1, -1) outside."""
    return _cell_at(cells, *_in_cells(cells, x, y))


@jit
def _in_cells(cells: Cells, x: float, y: float) -> tuple[float, float]:
    """Return how far a point is from the grid's corner [cells]."""
    return (x - cells.origin_x) / cells.resolution, (y - cells.origin_y) / cells.resolution


@jit
def _cell_at(cells: Cells, along: float, up: float) -> tuple[int, int]:
    if 0.0 <= along < cells.columns and 0.0 <= up < cells.rows:
        return int(along), int(up)
    return -1, -1


@jit
def map_plan(
    grid: CostGrid, plan: Poses, x: float, y: float, reach: int, shift: tuple[float, float]
) -> tuple[NDArray[np.int32], int, int, int, int, int, int]:
    """Return distances of cells to the plan, where they begin, goal cell and the nose's goal cell.

    The distances are of the cells that lie at most ``reach`` cells from a place, along each axis.
    The plan counts up to where it leaves the costmap. Obstacles do not stop the propagation,
    so its result is the Manhattan distance; it is large where the plan is not on the map.
    """
    costs, cells = grid.costs, _cells_of(grid)
    along, up = _in_cells(cells, x, y)
    column = min(max(math.floor(along), 0), cells.columns - 1)
    row = min(max(math.floor(up), 0), cells.rows - 1)
    left, right = max(column - reach, 0), min(column + reach, cells.columns - 1)
    low, high = max(row - reach, 0), min(row + reach, cells.rows - 1)
    far = cells.rows + cells.columns
    distance = np.full((high - low + 1, right - left + 1), far, dtype=np.int32)
    goal_x, goal_y, last = -1, -1, -1
    for i in range(len(plan)):
        column, row = _cell(cells, plan[i, 0], plan[i, 1])
        if column >= 0 and costs[row, column] != UNKNOWN:
            # Every way from a cell beyond the edge leads over the cell of the edge nearest to it.
            edge_x, edge_y = min(max(column, left), right), min(max(row, low), high)
            away = abs(column - edge_x) + abs(row - edge_y)
            at = edge_y - low, edge_x - left
            distance[at] = min(distance[at], away)
            goal_x, goal_y, last = column, row, i
        elif last >= 0:
            break
    _propagate(distance)
    nose_x, nose_y = goal_x, goal_y
    if 0 <= last == len(plan) - 1:
        column, row = _cell(cells, plan[last, 0] + shift[0], plan[last, 1] + shift[1])
        if column >= 0 and costs[row, column] != UNKNOWN:
            nose_x, nose_y = column, row
    return distance, left, low, goal_x, goal_y, nose_x, nose_y


@jit
def _propagate(distance: NDArray[np.int32]) -> None:
    """Lower distances to what a way over a neighbour gives."""
    rows, columns = distance.shape
    for row in range(1, rows):  # along columns, many at a time, then on from there along rows
        for column in range(columns):
            distance[row, column] = min(distance[row, column], distance[row - 1, column] + 1)
    for row in range(rows - 2, -1, -1):
        for column in range(columns):
            distance[row, column] = min(distance[row, column], distance[row + 1, column] + 1)
    for row in range(rows):
        for column in range(1, columns):
            distance[row, column] = min(distance[row, column], distance[row, column - 1] + 1)
        for column in range(columns - 2, -1, -1):
            distance[row, column] = min(distance[row, column], distance[row, column + 1] + 1)


@jit
def obstacle_cost(grid: CostGrid, rollout: Poses) -> int:
    """Return the cost under the last pose, -1 if the robot would hit something or leave."""
    costs, cells, cost = grid.costs, _cells_of(grid), 0
    for i in range(len(rollout)):
        column, row = _cell(cells, rollout[i, 0], rollout[i, 1])
        if column < 0:
            return -1
        cost = int(costs[row, column])
        if cost >= INSCRIBED:
            return -1
    return cost


@jit
def nose(parameters: sampling.Parameters, yaw: float) -> tuple[float, float]:
    """Return the position of the point in front of the robot, relative to the robot [m]."""
    distance = parameters.forward_point_distance
    return distance * math.cos(yaw), distance * math.sin(yaw)


@jit
def rotate_to_goal(
    parameters: sampling.Parameters, critics: Critics, v: float, yaw: float
) -> float:
    """Return the score near the goal: first for slowing down, then for facing the goal's yaw."""
    if not (critics.slowing or critics.rotating):
        return 0.0
    off = float((critics.goal_yaw - yaw + math.pi) % (2.0 * math.pi) - math.pi)
    slow = parameters.slowing_factor * v * v if critics.slowing else 0.0
    return slow + abs(off)


@jit
def _is_at_border(along: float) -> bool:
    """Return whether rounding could put a point into another cell; ``along`` is in cells."""
    inside = along - math.floor(along)
    return inside < _BORDER or inside > 1.0 - _BORDER


@jit
def search(start: sampling.Start, grid: CostGrid, critics: Critics) -> tuple[float, float, Poses]:
    """Return the legal twist with the lowest score, the first of equals, and its rollout.

    The twist is NaN, and the rollout empty, if there is none.

    The critics need the cell in which a rollout ends, which is computed without its steps. Only the
    collision test needs the steps. It is made for the trajectory with the lowest score, then for
    the next, until one is legal.
    """
    parameters, _, velocity = start
    forward, turning = sampling.twists(parameters, velocity)
    rollout = np.empty((sampling.most_poses(parameters, forward, turning), 3))
    if critics.goal_x < 0:
        return math.nan, math.nan, rollout[:0]
    totals = _totals(start, grid, critics, forward, turning, rollout)
    while True:
        index = int(np.argmin(totals))
        if totals[index] == math.inf:
            return math.nan, math.nan, rollout[:0]
        v, w = forward[index // len(turning)], turning[index % len(turning)]
        length = sampling.roll(start, (v, w), rollout)
        if obstacle_cost(grid, rollout[:length]) >= 0:
            return v, w, rollout[:length]
        totals[index] = math.inf


@jit_unchecked
def _totals(
    start: sampling.Start,
    grid: CostGrid,
    critics: Critics,
    forward: Floats,
    turning: Floats,
    rollout: Poses,
) -> Floats:
    """Return the score of each twist, infinite where the end of its rollout is illegal.

    Forward speeds by turning speeds, in one row. ``rollout`` is a work array.
    """
    parameters = start.parameters
    totals = np.full((len(forward), len(turning)), math.inf)
    forward = forward[: _slow_enough(critics, forward)]
    at_least = np.empty(len(forward), np.int64)  # steps, for the forward speed alone
    for i in range(len(forward)):
        at_least[i] = sampling.step_count(parameters, (forward[i], 0.0))
    way, points = np.empty((len(rollout) - 1, 4)), np.empty((len(forward), 4))
    nose = parameters.forward_point_distance
    near, yaw = critics.slowing or critics.rotating, 0.0
    for j in range(len(turning)):
        w = turning[j]
        if critics.turn * w < 0.0:
            continue
        steps = sampling.step_count(parameters, (0.0, w))
        last = 0
        while last < len(forward):  # speeds with equally many steps at once
            first, count = last, max(steps, at_least[last])
            while last < len(forward) and max(steps, at_least[last]) == count:
                last += 1
            v = forward[first:last]
            x, y = sampling.headings(start, w, count, way)
            sampling.ends(start, v, count, way, (nose * x, nose * y), points)
            _take_to_cells(start, grid, v, w, points, rollout)
            if near:
                yaw = sampling.last_yaw(start, w, count)
            _score(parameters, grid, critics, v, w, yaw, points, totals[first:last, j])
    return totals.ravel()


@jit
def _slow_enough(critics: Critics, forward: Floats) -> int:
    """Return how many of the ascending forward speeds are legal near the goal."""
    for i in range(len(forward)):
        v = forward[i]
        if (critics.rotating and v > 0.0) or (critics.slowing and v * v >= critics.speed_squared):
            return i
    return len(forward)


@jit_unchecked
def _take_to_cells(
    start: sampling.Start, grid: CostGrid, forward: Floats, w: float, points: Floats, rollout: Poses
) -> None:
    """Turn metres into cells; roll out where rounding could put a point into another cell."""
    origin_x, origin_y, per_metre = grid.origin_x, grid.origin_y, 1.0 / grid.resolution
    for i in range(len(forward)):
        left, low = (points[i, 0] - origin_x) * per_metre, (points[i, 1] - origin_y) * per_metre
        left_ahead = (points[i, 2] - origin_x) * per_metre
        low_ahead = (points[i, 3] - origin_y) * per_metre
        if (
            _is_at_border(left)
            or _is_at_border(low)
            or _is_at_border(left_ahead)
            or _is_at_border(low_ahead)
        ):
            end = rollout[sampling.roll(start, (forward[i], w), rollout) - 1]
            nose_x, nose_y = nose(start.parameters, end[2])
            cells = _cells_of(grid)
            left, low = _in_cells(cells, end[0], end[1])
            left_ahead, low_ahead = _in_cells(cells, end[0] + nose_x, end[1] + nose_y)
        points[i, 0], points[i, 1] = left, low
        points[i, 2], points[i, 3] = left_ahead, low_ahead


@jit_unchecked
def _score(
    parameters: sampling.Parameters,
    grid: CostGrid,
    critics: Critics,
    forward: Floats,
    w: float,
    yaw: float,
    points: Floats,
    totals: Floats,
) -> None:
    """Fill in the scores of rollouts by their last points and those in front of them [cells]."""
    # Taken out of the tuples once: their arrays are counted each time that they are.
    costs, distance, cells = grid.costs, critics.path_distance, _cells_of(grid)
    near = critics.slowing or critics.rotating
    for i in range(len(forward)):
        v = forward[i]
        if v == 0.0 and w == 0.0:
            continue
        column, row = _cell_at(cells, points[i, 0], points[i, 1])
        ahead, up = _cell_at(cells, points[i, 2], points[i, 3])
        if column < 0 or ahead < 0 or costs[row, column] >= INSCRIBED:
            continue
        goal_align = abs(ahead - critics.nose_x) + abs(up - critics.nose_y)
        goal_dist = abs(column - critics.goal_x) + abs(row - critics.goal_y)
        total = parameters.goal_align_scale * goal_align + parameters.goal_dist_scale * goal_dist
        total += parameters.path_dist_scale * distance[row - critics.low, column - critics.left]
        if critics.align_path:
            path_align = distance[up - critics.low, ahead - critics.left]
            total += parameters.path_align_scale * path_align
        total = 0.5 * grid.resolution * total
        if near:
            rotate = rotate_to_goal(parameters, critics, v, yaw)
            total += parameters.rotate_to_goal_scale * rotate
        totals[i] = total + parameters.base_obstacle_scale * int(costs[row, column])
