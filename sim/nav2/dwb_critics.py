"""DWB's seven critics, and the search for the velocity with the lowest score.

As ``dwb_critics`` on Humble. Critics that depend only on the end of a trajectory come first.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit
from sim.nav2.dwb_sampling import Parameters, headings, place, roll, step_count, twists
from sim.nav2.paths import Poses

INSCRIBED = 253  # from this cost on the robot's centre must not be in a cell; 255 is unknown
UNKNOWN = 255
_BORDER = 1e-6  # this close to the edge of a cell, the sums of a rollout decide [cells]


class CostGrid(NamedTuple):
    """A costmap as the kernels see it."""

    costs: NDArray[np.uint8]  # shape (rows, columns); row 0 has the smallest y
    resolution: float  # [m]
    origin_x: float  # of the lower left corner [m]
    origin_y: float


class Critics(NamedTuple):
    """Inputs of the critics that are constant within one cycle."""

    path_distance: NDArray[np.int32]  # cells to the nearest cell of the path, by rows and columns
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


class Scoring(NamedTuple):
    """Everything that determines the choice of one cycle."""

    parameters: Parameters
    grid: CostGrid
    pose: tuple[float, float, float]  # of the robot in the costmap's frame [m, m, rad]
    velocity: tuple[float, float]  # of the robot [m/s, rad/s]
    critics: Critics


@jit
def cell(grid: CostGrid, x: float, y: float) -> tuple[int, int]:
    """Return column and row of a point, (-1, -1) outside."""
    return _cell_at(grid, *_in_cells(grid, x, y))


@jit
def _in_cells(grid: CostGrid, x: float, y: float) -> tuple[float, float]:
    """Return how far a point is from the grid's corner [cells]."""
    return (x - grid.origin_x) / grid.resolution, (y - grid.origin_y) / grid.resolution


@jit
def _cell_at(grid: CostGrid, along: float, up: float) -> tuple[int, int]:
    column, row = math.floor(along), math.floor(up)
    if 0 <= column < grid.costs.shape[1] and 0 <= row < grid.costs.shape[0]:
        return int(column), int(row)
    return -1, -1


@jit
def map_plan(
    grid: CostGrid, plan: Poses, shift_x: float, shift_y: float
) -> tuple[NDArray[np.int32], int, int, int, int]:
    """Return the distance of every cell to the plan, the goal cell and the nose's goal cell.

    The plan counts up to where it leaves the costmap. Obstacles do not stop the propagation,
    so its result is the Manhattan distance; it is large where the plan is not on the map.
    """
    rows, columns = grid.costs.shape
    distance = np.full((rows, columns), rows + columns, dtype=np.int32)
    goal_x, goal_y, last = -1, -1, -1
    for i in range(len(plan)):
        column, row = cell(grid, plan[i, 0], plan[i, 1])
        if column >= 0 and grid.costs[row, column] != UNKNOWN:
            distance[row, column] = 0
            goal_x, goal_y, last = column, row, i
        elif last >= 0:
            break
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
    nose_x, nose_y = goal_x, goal_y
    if last == len(plan) - 1:
        column, row = cell(grid, plan[last, 0] + shift_x, plan[last, 1] + shift_y)
        if column >= 0 and grid.costs[row, column] != UNKNOWN:
            nose_x, nose_y = column, row
    return distance, goal_x, goal_y, nose_x, nose_y


@jit
def cost_at(grid: CostGrid, x: float, y: float) -> int:
    """Return the cost under a point; outside it is unknown."""
    column, row = cell(grid, x, y)
    return UNKNOWN if column < 0 else int(grid.costs[row, column])


@jit
def obstacle_cost(grid: CostGrid, rollout: Poses) -> int:
    """Return the cost under the last pose, -1 if the robot would hit something or leave."""
    cost = 0
    for i in range(len(rollout)):
        cost = cost_at(grid, rollout[i, 0], rollout[i, 1])
        if cost >= INSCRIBED:
            return -1
    return cost


@jit
def map_cells(
    parameters: Parameters, grid: CostGrid, critics: Critics, end: NDArray[np.float64]
) -> tuple[int, int, int, int]:
    """Return the scores of the four critics of the end of a rollout [cells].

    They are goal align, path align (0 where it is off), path dist and goal dist; all are -1 if
    the rollout, or the point in front of the robot, ends outside the costmap.
    """
    nose_x, nose_y = nose(parameters, end[2])
    here, ahead = cell(grid, end[0], end[1]), cell(grid, end[0] + nose_x, end[1] + nose_y)
    return _cells_at(critics, here, ahead)


@jit
def nose(parameters: Parameters, yaw: float) -> tuple[float, float]:
    """Return the position of the point in front of the robot, relative to the robot [m]."""
    distance = parameters.forward_point_distance
    return distance * math.cos(yaw), distance * math.sin(yaw)


@jit
def _cells_at(
    critics: Critics, here: tuple[int, int], ahead: tuple[int, int]
) -> tuple[int, int, int, int]:
    (column, row), (ahead_column, ahead_row) = here, ahead
    if column < 0 or ahead_column < 0:
        return -1, -1, -1, -1
    goal_align = abs(ahead_column - critics.nose_x) + abs(ahead_row - critics.nose_y)
    goal_dist = abs(column - critics.goal_x) + abs(row - critics.goal_y)
    path_dist = int(critics.path_distance[row, column])
    path_align = int(critics.path_distance[ahead_row, ahead_column]) if critics.align_path else 0
    return goal_align, path_align, path_dist, goal_dist


@jit
def map_score(parameters: Parameters, grid: CostGrid, cells: tuple[int, int, int, int]) -> float:
    """Return the weighted sum of what ``map_cells`` returned; infinite outside the costmap."""
    goal_align, path_align, path_dist, goal_dist = cells
    if goal_align < 0:
        return math.inf
    total = parameters.goal_align_scale * goal_align + parameters.goal_dist_scale * goal_dist
    total += parameters.path_dist_scale * path_dist
    total += parameters.path_align_scale * path_align
    return 0.5 * grid.resolution * float(total)


@jit
def rotate_to_goal(parameters: Parameters, critics: Critics, v: float, yaw: float) -> float:
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
def search(
    parameters: Parameters,
    grid: CostGrid,
    pose: tuple[float, float, float],
    velocity: tuple[float, float],
    critics: Critics,
) -> tuple[float, float, Poses]:
    """Return the legal twist with the lowest score, the first of equals, and its rollout.

    The twist is NaN, and the rollout empty, if there is none.

    The critics need the cell in which a rollout ends, which is computed without its steps. Only the
    collision test needs the steps. It is made for the trajectory with the lowest score, then for
    the next, until one is legal.
    """
    rollout = np.empty((_longest(parameters) + 2, 3))
    if critics.goal_x < 0:
        return math.nan, math.nan, rollout[:0]
    forward, turning = twists(parameters, velocity)
    totals = _totals(parameters, grid, pose, velocity, critics, forward, turning, rollout)
    while True:
        index = int(np.argmin(totals))
        if totals[index] == math.inf:
            return math.nan, math.nan, rollout[:0]
        v, w = forward[index // len(turning)], turning[index % len(turning)]
        length = roll(parameters, pose, velocity, (v, w), rollout)
        if obstacle_cost(grid, rollout[:length]) >= 0:
            return v, w, rollout[:length]
        totals[index] = math.inf


@jit
def _longest(parameters: Parameters) -> int:
    """Return the most steps that a rollout takes."""
    return step_count(parameters, (parameters.max_vel_x, parameters.max_vel_theta))


@jit
def _totals(
    parameters: Parameters,
    grid: CostGrid,
    pose: tuple[float, float, float],
    velocity: tuple[float, float],
    critics: Critics,
    forward: NDArray[np.float64],
    turning: NDArray[np.float64],
    rollout: Poses,
) -> NDArray[np.float64]:
    """Return the score of each twist, infinite where the end of its rollout is illegal.

    Forward speeds by turning speeds, in one row. ``rollout`` is a work array.
    """
    totals = np.full(len(forward) * len(turning), math.inf)
    # By turning speed: in how many steps its way is known, that way, and at its end the yaw and
    # where the nose is.
    known = np.zeros(len(turning), np.int64)
    ways = np.empty((len(turning), len(rollout) - 1, 2))
    ends = np.empty((len(turning), 3))
    for i in range(len(forward)):
        v = forward[i]
        if critics.rotating and v > 0.0:
            break
        if critics.slowing and v * v >= critics.speed_squared:
            break
        for j in range(len(turning)):
            w = turning[j]
            if (v == 0.0 and w == 0.0) or critics.turn * w < 0.0:
                continue
            count = step_count(parameters, (v, w))
            if known[j] != count:
                known[j] = count
                yaw = headings(parameters, pose[2], velocity[1], w, count, ways[j])
                ends[j, 0] = yaw
                ends[j, 1], ends[j, 2] = nose(parameters, yaw)
            yaw, nose_x, nose_y = ends[j]
            x, y = place(parameters, pose[0], pose[1], velocity[0], v, count, ways[j])
            here = _in_cells(grid, x, y)
            ahead = _in_cells(grid, x + nose_x, y + nose_y)
            if (
                _is_at_border(here[0])
                or _is_at_border(here[1])
                or _is_at_border(ahead[0])
                or _is_at_border(ahead[1])
            ):
                x, y, _ = rollout[roll(parameters, pose, velocity, (v, w), rollout) - 1]
                here = _in_cells(grid, x, y)
                ahead = _in_cells(grid, x + nose_x, y + nose_y)
            column, row = _cell_at(grid, *here)
            cells = _cells_at(critics, (column, row), _cell_at(grid, *ahead))
            total = map_score(parameters, grid, cells)
            total += parameters.rotate_to_goal_scale * rotate_to_goal(parameters, critics, v, yaw)
            if total < math.inf and grid.costs[row, column] < INSCRIBED:  # false for NaN, too
                cost = int(grid.costs[row, column])
                totals[i * len(turning) + j] = total + parameters.base_obstacle_scale * cost
    return totals
