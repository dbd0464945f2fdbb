"""The DWB local planner: sample velocities, roll each one out, let seven critics choose.

Sampling, rollout and critics are those of Nav2's ``dwb_core``, ``dwb_plugins`` and
``dwb_critics`` on Humble. Nothing here knows about topics or actions; that is the
controller server's part.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit
from sim.middleware.geometry import Pose2D, wrap_angle
from sim.nav2.paths import Poses

INSCRIBED = 253  # from this cost on the robot's centre must not be in a cell; 255 is unknown
UNKNOWN = 255
_EPSILON = 1e-5


class Parameters(NamedTuple):
    """The Waffle's values in ``nav2_params.yaml``; names as there.

    Only ``sim_time`` is ours (there: 1.7 s); why is in docs/explanation/navigation.md.
    """

    max_vel_x: float = 0.26  # [m/s]; the robot never drives backwards
    max_vel_theta: float = 1.0  # [rad/s], to either side
    acc_lim_x: float = 2.5  # [m/s^2]
    decel_lim_x: float = -2.5  # [m/s^2]
    acc_lim_theta: float = 3.2  # [rad/s^2]
    decel_lim_theta: float = -3.2  # [rad/s^2]
    vx_samples: int = 20
    vtheta_samples: int = 20
    sim_time: float = 1.0  # [s]
    linear_granularity: float = 0.05  # [m]
    angular_granularity: float = 0.025  # [rad]
    prune_distance: float = 2.0  # of the plan kept behind the robot [m]
    forward_prune_distance: float = 2.0  # of the plan followed ahead of it [m]
    xy_goal_tolerance: float = 0.25  # [m]
    trans_stopped_velocity: float = 0.25  # [m/s]
    slowing_factor: float = 5.0
    forward_point_distance: float = 0.1  # [m]
    rotate_to_goal_scale: float = 32.0
    base_obstacle_scale: float = 0.02
    goal_align_scale: float = 24.0
    path_align_scale: float = 32.0
    path_dist_scale: float = 32.0
    goal_dist_scale: float = 24.0


class CostGrid(NamedTuple):
    """A costmap as the kernels see it."""

    costs: NDArray[np.uint8]  # shape (rows, columns); row 0 has the smallest y
    resolution: float  # [m]
    origin_x: float  # of the lower left corner [m]
    origin_y: float


class _Critics(NamedTuple):
    """What the critics hold on to while the trajectories of one cycle are scored."""

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
    """All that the choice of one cycle is a function of."""

    parameters: Parameters
    grid: CostGrid
    pose: tuple[float, float, float]  # of the robot in the costmap's frame [m, m, rad]
    velocity: tuple[float, float]  # of the robot [m/s, rad/s]
    critics: _Critics


@dataclass(frozen=True, slots=True)
class Cycle:
    """What one control cycle came to; poses are in the costmap's frame."""

    twist: tuple[float, float] | None  # [m/s, rad/s]; None if no trajectory is legal
    plan: Poses  # the part of the plan that was followed
    trajectory: Poses  # the rollout of ``twist``
    scoring: Scoring | None = None  # what the critics were asked; None if they were not


class LocalPlanner:
    """Follows a plan, one velocity at a time.

    Parameters
    ----------
    parameters
        Limits, sampling and scales.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self._base = parameters or Parameters()
        self._limited = self._base
        self.plan: Poses = np.empty((0, 3))
        self._near_goal = False
        self._rotating = False
        self._turns = _Trend()

    def set_plan(self, plan: Poses, *, same_goal: bool = False) -> None:
        """Follow ``plan`` of shape (n, 3) from now on; the critics forget what was.

        On the way to the same goal as before, what they know of the arrival stays.
        """
        self.plan = plan
        self._near_goal &= same_goal
        self._rotating &= same_goal
        self._turns = _Trend()

    def limit_speed(self, limit: float, *, percentage: bool) -> None:
        """Scale the speed limits to ``limit`` (per cent, or m/s); 0 lifts the limit."""
        base = self._base
        ratio = limit / 100.0 if percentage else min(1.0, limit / base.max_vel_x)
        if limit == 0.0:
            ratio = 1.0
        self._limited = base._replace(
            max_vel_x=base.max_vel_x * ratio, max_vel_theta=base.max_vel_theta * ratio
        )

    def compute(
        self, grid: CostGrid, pose: Pose2D, velocity: tuple[float, float], from_plan: Pose2D
    ) -> Cycle:
        """Choose the next velocity.

        Parameters
        ----------
        grid
            Local costmap.
        pose
            The robot in the costmap's frame.
        velocity
            Of the robot, forward and turning [m/s, rad/s].
        from_plan
            Takes the plan's frame into the costmap's frame.
        """
        parameters = self._limited
        near = self.followed(pose, grid, from_plan)
        if not len(near):
            return Cycle(None, near, near)
        goal = from_plan.compose(Pose2D(*self.plan[-1]))
        critics = self._prepare(grid, pose, velocity, goal, near)
        scoring = Scoring(parameters, grid, (pose.x, pose.y, pose.yaw), velocity, critics)
        twist = _search(*scoring)
        legal = not math.isnan(twist[0])
        self._turns.debrief(twist if legal else (0.0, 0.0), pose)
        if not legal:
            return Cycle(None, near, near[:0], scoring)
        rollout = np.empty((_steps(parameters, twist) + 2, 3))
        _roll(parameters, scoring.pose, velocity, twist, rollout)
        return Cycle(twist, near, rollout, scoring)

    def followed(self, pose: Pose2D, grid: CostGrid, from_plan: Pose2D) -> Poses:
        """Forget what lies behind; return the part to follow, in the costmap's frame."""
        robot = from_plan.inverse().compose(pose)
        reach = max(grid.costs.shape) * grid.resolution / 2.0
        begin, end = _window(self.plan, robot.x, robot.y, reach, self._base)
        self.plan = self.plan[begin:]
        return _transform(self.plan[: end - begin], from_plan)

    def _prepare(
        self,
        grid: CostGrid,
        pose: Pose2D,
        velocity: tuple[float, float],
        goal: Pose2D,
        plan: Poses,
    ) -> _Critics:
        parameters = self._limited
        distance = pose.distance_to(goal)
        speed_squared = velocity[0] ** 2
        self._near_goal |= distance <= parameters.xy_goal_tolerance
        self._rotating |= self._near_goal and speed_squared <= parameters.trans_stopped_velocity**2
        ahead = math.atan2(goal.y - pose.y, goal.x - pose.x)
        path_distance, goal_x, goal_y, nose_x, nose_y = _map_plan(
            grid,
            plan,
            parameters.forward_point_distance * math.cos(ahead),
            parameters.forward_point_distance * math.sin(ahead),
        )
        return _Critics(
            path_distance,
            goal_x,
            goal_y,
            nose_x,
            nose_y,
            goal.yaw,
            align_path=distance > parameters.forward_point_distance,
            slowing=self._near_goal and not self._rotating,
            rotating=self._rotating,
            speed_squared=speed_squared,
            turn=self._turns.only,
        )


class _Trend:
    """The oscillation critic's memory: no turning back and forth on the spot.

    The critic also watches driving forth and back, which this robot's limits rule out.
    """

    RESET_DISTANCE_M = 0.05
    RESET_ANGLE_RAD = 0.2
    X_ONLY_THRESHOLD = 0.05  # faster than this, turning is no oscillation [m/s]

    def __init__(self) -> None:
        self.only = 0
        self._sign = 0
        self._flipped_at = Pose2D()

    def debrief(self, twist: tuple[float, float], pose: Pose2D) -> None:
        """Take note of the velocity that was chosen."""
        sign = (twist[1] > 0.0) - (twist[1] < 0.0)
        if sign and abs(twist[0]) <= self.X_ONLY_THRESHOLD:
            if sign == -self._sign:
                self.only = sign
                self._flipped_at = pose
            self._sign = sign
        if self.only and (
            pose.distance_to(self._flipped_at) > self.RESET_DISTANCE_M
            or abs(wrap_angle(pose.yaw - self._flipped_at.yaw)) > self.RESET_ANGLE_RAD
        ):
            self.only = self._sign = 0


def _transform(poses: Poses, transform: Pose2D) -> Poses:
    moved = np.empty_like(poses)
    moved[:, :2] = transform.apply(poses[:, :2])
    moved[:, 2] = poses[:, 2] + transform.yaw
    return moved


@jit
def _window(
    plan: Poses, x: float, y: float, reach: float, parameters: Parameters
) -> tuple[int, int]:
    """Return first and end index of the plan's part near the robot.

    It begins with the first pose within ``reach`` (half the costmap) and ``prune_distance``, not
    looking further along the plan than the latter, and goes on to the first pose beyond ``reach``
    or ``forward_prune_distance``.
    """
    behind = min(reach, parameters.prune_distance)
    ahead = min(reach, parameters.forward_prune_distance)
    begin, along = 0, 0.0
    while begin < len(plan) and math.hypot(plan[begin, 0] - x, plan[begin, 1] - y) >= behind:
        if begin > 0:
            along += math.hypot(
                plan[begin, 0] - plan[begin - 1, 0], plan[begin, 1] - plan[begin - 1, 1]
            )
        if along > parameters.prune_distance:
            break
        begin += 1
    end = begin
    while end < len(plan) and math.hypot(plan[end, 0] - x, plan[end, 1] - y) <= ahead:
        end += 1
    return begin, end


@jit
def _cell(grid: CostGrid, x: float, y: float) -> tuple[int, int]:
    """Return column and row of a point, (-1, -1) outside."""
    column = math.floor((x - grid.origin_x) / grid.resolution)
    row = math.floor((y - grid.origin_y) / grid.resolution)
    if 0 <= column < grid.costs.shape[1] and 0 <= row < grid.costs.shape[0]:
        return int(column), int(row)
    return -1, -1


@jit
def _map_plan(
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
        column, row = _cell(grid, plan[i, 0], plan[i, 1])
        if column >= 0 and grid.costs[row, column] != UNKNOWN:
            distance[row, column] = 0
            goal_x, goal_y, last = column, row, i
        elif last >= 0:
            break
    for row in range(rows):
        for column in range(columns):
            if row > 0:
                distance[row, column] = min(distance[row, column], distance[row - 1, column] + 1)
            if column > 0:
                distance[row, column] = min(distance[row, column], distance[row, column - 1] + 1)
    for row in range(rows - 1, -1, -1):
        for column in range(columns - 1, -1, -1):
            if row < rows - 1:
                distance[row, column] = min(distance[row, column], distance[row + 1, column] + 1)
            if column < columns - 1:
                distance[row, column] = min(distance[row, column], distance[row, column + 1] + 1)
    nose_x, nose_y = goal_x, goal_y
    if last == len(plan) - 1:
        column, row = _cell(grid, plan[last, 0] + shift_x, plan[last, 1] + shift_y)
        if column >= 0 and grid.costs[row, column] != UNKNOWN:
            nose_x, nose_y = column, row
    return distance, goal_x, goal_y, nose_x, nose_y


@jit
def _approach(current: float, target: float, rise: float, fall: float) -> float:
    """Return the speed after changing towards ``target`` by at most ``rise`` or ``-fall``."""
    if current < target:
        return min(target, current + rise)
    return max(target, current + fall)


@jit
def _samples(
    current: float, low: float, high: float, rise: float, fall: float, count: int
) -> NDArray[np.float64]:
    """Return the speeds to try: evenly over what can be reached, and zero if it is between."""
    top, bottom = _approach(current, high, rise, fall), _approach(current, low, rise, fall)
    speeds = np.empty(count + 1)
    if abs(top - bottom) < _EPSILON:
        speeds[0] = bottom
        return speeds[:1]
    step = (top - bottom) / (count - 1)
    size = 0
    for i in range(count):
        speed = bottom + i * step
        if i > 0 and speeds[size - 1] < 0.0 < speed:
            speeds[size] = 0.0
            size += 1
        speeds[size] = speed
        size += 1
    return speeds[:size]


@jit
def _twists(
    parameters: Parameters, velocity: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the forward and the turning speeds to try; every pair but (0, 0) is a twist."""
    time = parameters.sim_time
    forward = _samples(
        velocity[0],
        0.0,
        parameters.max_vel_x,
        parameters.acc_lim_x * time,
        parameters.decel_lim_x * time,
        parameters.vx_samples,
    )
    turning = _samples(
        velocity[1],
        -parameters.max_vel_theta,
        parameters.max_vel_theta,
        parameters.acc_lim_theta * time,
        parameters.decel_lim_theta * time,
        parameters.vtheta_samples,
    )
    return forward, turning


@jit
def _steps(parameters: Parameters, twist: tuple[float, float]) -> int:
    """Return in how many steps a velocity is rolled out."""
    linear = abs(twist[0]) * parameters.sim_time / parameters.linear_granularity
    angular = abs(twist[1]) * parameters.sim_time / parameters.angular_granularity
    return max(1, math.ceil(max(linear, angular)))


@jit
def _roll(
    parameters: Parameters,
    pose: tuple[float, float, float],
    velocity: tuple[float, float],
    twist: tuple[float, float],
    rollout: Poses,
) -> int:
    """Drive from ``pose`` towards ``twist`` for ``sim_time``; return how many poses were written.

    The first is where the robot is, the last one stands twice (``include_last_point``).
    """
    x, y, yaw = pose
    v, w = velocity
    steps = _steps(parameters, twist)
    dt = parameters.sim_time / steps
    heading_x, heading_y = math.cos(yaw), math.sin(yaw)
    turn_x, turn_y, turned = 1.0, 0.0, 0.0
    rollout[0, 0], rollout[0, 1], rollout[0, 2] = x, y, yaw
    for i in range(1, steps + 1):
        v = _approach(v, twist[0], parameters.acc_lim_x * dt, parameters.decel_lim_x * dt)
        w = _approach(w, twist[1], parameters.acc_lim_theta * dt, parameters.decel_lim_theta * dt)
        x += v * heading_x * dt
        y += v * heading_y * dt
        yaw += w * dt
        if w != turned:  # after speeding up it stays, and so does the rotation of a step
            turn_x, turn_y, turned = math.cos(w * dt), math.sin(w * dt), w
        heading_x, heading_y = (
            heading_x * turn_x - heading_y * turn_y,
            heading_y * turn_x + heading_x * turn_y,
        )
        rollout[i, 0], rollout[i, 1], rollout[i, 2] = x, y, yaw
    rollout[steps + 1] = rollout[steps]
    return steps + 2


@jit
def _obstacle_cost(grid: CostGrid, rollout: Poses) -> int:
    """Return the cost under the last pose, -1 if the robot would hit something or leave."""
    cost = 0
    for i in range(len(rollout)):
        column, row = _cell(grid, rollout[i, 0], rollout[i, 1])
        if column < 0:
            return -1
        cost = int(grid.costs[row, column])
        if cost >= INSCRIBED:
            return -1
    return cost


@jit
def _map_cells(
    parameters: Parameters, grid: CostGrid, critics: _Critics, end: NDArray[np.float64]
) -> tuple[int, int, int, int]:
    """Return what the four critics that look at the end of a rollout say [cells].

    They are goal align, path align (0 where it is off), path dist and goal dist; all are -1 if
    the rollout, or the point in front of the robot, ends outside the costmap.
    """
    column, row = _cell(grid, end[0], end[1])
    ahead_column, ahead_row = _cell(
        grid,
        end[0] + parameters.forward_point_distance * math.cos(end[2]),
        end[1] + parameters.forward_point_distance * math.sin(end[2]),
    )
    if column < 0 or ahead_column < 0:
        return -1, -1, -1, -1
    goal_align = abs(ahead_column - critics.nose_x) + abs(ahead_row - critics.nose_y)
    goal_dist = abs(column - critics.goal_x) + abs(row - critics.goal_y)
    path_dist = int(critics.path_distance[row, column])
    path_align = int(critics.path_distance[ahead_row, ahead_column]) if critics.align_path else 0
    return goal_align, path_align, path_dist, goal_dist


@jit
def _map_score(
    parameters: Parameters, grid: CostGrid, critics: _Critics, end: NDArray[np.float64]
) -> float:
    """Return the weighted sum of those four critics; infinite outside the costmap."""
    goal_align, path_align, path_dist, goal_dist = _map_cells(parameters, grid, critics, end)
    if goal_align < 0:
        return math.inf
    total = parameters.goal_align_scale * goal_align + parameters.goal_dist_scale * goal_dist
    total += parameters.path_dist_scale * path_dist
    total += parameters.path_align_scale * path_align
    return 0.5 * grid.resolution * float(total)


@jit
def _rotate_to_goal(
    parameters: Parameters, critics: _Critics, v: float, end: NDArray[np.float64]
) -> float:
    """Return what the critic near the goal says: slow down, then face the goal's yaw."""
    if not (critics.slowing or critics.rotating):
        return 0.0
    off = float((critics.goal_yaw - end[2] + math.pi) % (2.0 * math.pi) - math.pi)
    slow = parameters.slowing_factor * v * v if critics.slowing else 0.0
    return slow + abs(off)


@jit
def _search(
    parameters: Parameters,
    grid: CostGrid,
    pose: tuple[float, float, float],
    velocity: tuple[float, float],
    critics: _Critics,
) -> tuple[float, float]:
    """Return the legal twist with the lowest score, the first of equals; NaN if there is none."""
    best, best_v, best_w = math.inf, math.nan, math.nan
    if critics.goal_x < 0:
        return best_v, best_w
    forward, turning = _twists(parameters, velocity)
    longest = _steps(parameters, (parameters.max_vel_x, parameters.max_vel_theta))
    rollout = np.empty((longest + 2, 3))
    for v in forward:
        if critics.rotating and v > 0.0:
            break
        if critics.slowing and v * v >= critics.speed_squared:
            break
        for w in turning:
            if (v == 0.0 and w == 0.0) or critics.turn * w < 0.0:
                continue
            length = _roll(parameters, pose, velocity, (v, w), rollout)
            end = rollout[length - 1]
            total = _map_score(parameters, grid, critics, end)
            total += parameters.rotate_to_goal_scale * _rotate_to_goal(parameters, critics, v, end)
            if total >= best:  # the obstacle critic can only add to it
                continue
            cost = _obstacle_cost(grid, rollout[:length])
            total += parameters.base_obstacle_scale * cost
            if cost >= 0 and total < best:
                best, best_v, best_w = total, v, w
    return best_v, best_w
