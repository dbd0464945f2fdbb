"""The DWB local planner: samples velocities, simulates each one, and scores them by critics.

Sampling and rollout are in ``dwb_sampling``, the critics in ``dwb_critics``. This module keeps the
state between cycles, as Nav2 does on Humble. Topics and actions belong to the controller server.
"""

import math
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.middleware.geometry import Planar, Pose2D, composed, inverted, wrap_angle
from sim.nav2.costmap import CostGrid
from sim.nav2.dwb_critics import Critics, map_plan, search
from sim.nav2.dwb_sampling import Parameters, Start
from sim.nav2.paths import Poses

_FASTEST = 100.0  # [m/s, rad/s]


class Cycle(NamedTuple):
    """Result of one control cycle; poses are in the costmap's frame."""

    twist: tuple[float, float] | None  # [m/s, rad/s]; None if no trajectory is legal
    plan: Poses  # the part of the plan that was followed
    trajectory: Poses  # the rollout of ``twist``


class LocalPlanner:
    """Follows a plan, one velocity at a time.

    Parameters
    ----------
    parameters
        Limits, sampling and scales.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self._base = parameters or Parameters()
        self._limited, self._share = self._base, 1.0  # share of the maximal speed
        self.plan: Poses = np.empty((0, 3))
        self._near_goal = False
        self._rotating = False
        self._turns = _Trend()

    def set_plan(self, plan: Poses, *, same_goal: bool = False) -> None:
        """Follow ``plan`` of shape (n, 3) from now on; and reset the critics.

        If the goal is the same as before, their state of the arrival is kept.
        """
        self.plan = plan
        self._near_goal &= same_goal
        self._rotating &= same_goal
        self._turns = _Trend()

    def limit_speed(self, limit: float, *, percentage: bool) -> None:
        """Scale the speed limits to ``limit`` (per cent, or m/s); 0 lifts the limit."""
        base = self._base
        self._share = limit / 100.0 if percentage else min(1.0, limit / base.max_vel_x)
        if limit == 0.0:
            self._share = 1.0
        self.configure(base)

    @property
    def parameters(self) -> Parameters:
        """Limits, sampling and scales, without the speed limit."""
        return self._base

    def configure(self, parameters: Parameters) -> None:
        """Use other parameters from now on; a speed limit stays."""
        self._base, share = parameters, self._share
        self._limited = parameters._replace(
            max_vel_x=parameters.max_vel_x * share, max_vel_theta=parameters.max_vel_theta * share
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
        if not len(self.plan):
            return Cycle(None, self.plan, self.plan)
        if not all(abs(speed) < _FASTEST for speed in velocity):  # false odometry, NaN included
            near = self.followed(pose, grid, from_plan)
            return Cycle(None, near, near[:0])
        begin, near, forward, turning, rollout, critics = _choose(
            Start(self._limited, (pose.x, pose.y, pose.yaw), velocity), grid, self.plan,
            (from_plan.x, from_plan.y, from_plan.yaw),
            self._near_goal, self._rotating, self._turns.only,
        )  # fmt: skip
        self.plan = self.plan[begin:]
        if not len(near):
            return Cycle(None, near, near)
        self._near_goal, self._rotating = critics.slowing or critics.rotating, critics.rotating
        twist = None if math.isnan(forward) else (forward, turning)
        self._turns.debrief(twist or (0.0, 0.0), pose)
        return Cycle(twist, near, rollout)

    def followed(self, pose: Pose2D, grid: CostGrid, from_plan: Pose2D) -> Poses:
        """Drop the plan behind the robot; return the part to follow, in the costmap's frame."""
        begin, near = _followed(
            self._limited, grid, self.plan, (pose.x, pose.y, pose.yaw),
            (from_plan.x, from_plan.y, from_plan.yaw),
        )  # fmt: skip
        self.plan = self.plan[begin:]
        return near


class _Trend:
    """State of the oscillation critic, which prevents turning back and forth in place.

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
        """Update the state with the chosen velocity."""
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


@jit
def _choose(
    start: Start,
    grid: CostGrid,
    plan: Poses,
    from_plan: Planar,
    near_goal: bool,
    rotating: bool,
    turn: int,
) -> tuple[int, Poses, float, float, Poses, Critics]:
    """Return what `_followed` and `search` do, and the input of the critics.

    ``near_goal`` and ``rotating`` are how the robot was in the cycle before, and ``turn`` is the
    side to which it may turn; the others are those of `LocalPlanner.compute`.
    """
    begin, near = _followed(start.parameters, grid, plan, start.pose, from_plan)
    goal = composed(from_plan, plan[-1])
    critics = _critics(start, grid, near, goal, near_goal, rotating, turn)
    forward, turning, rollout = search(start, grid, critics)
    return begin, near, forward, turning, rollout, critics


@jit
def _critics(
    start: Start,
    grid: CostGrid,
    near: Poses,
    goal: Planar,
    near_goal: bool,
    rotating: bool,
    turn: int,
) -> Critics:
    """Return what the critics need to know; ``near`` is the plan's part near the robot."""
    parameters, pose, velocity = start
    distance = math.hypot(pose[0] - goal[0], pose[1] - goal[1])
    speed_squared = velocity[0] ** 2
    near_goal = near_goal or distance <= parameters.xy_goal_tolerance
    stopped = speed_squared <= parameters.trans_stopped_velocity**2
    rotating = rotating or (near_goal and stopped)
    nose = parameters.forward_point_distance
    ahead = math.atan2(goal[1] - pose[1], goal[0] - pose[0])
    fastest = max(abs(velocity[0]), parameters.max_vel_x)
    reach = int((fastest * parameters.sim_time + nose) / grid.resolution) + 2
    path_distance, left, low, goal_x, goal_y, nose_x, nose_y = map_plan(
        grid, near, pose[0], pose[1], reach, (nose * math.cos(ahead), nose * math.sin(ahead))
    )
    return Critics(
        path_distance, left, low, goal_x, goal_y, nose_x, nose_y, goal[2],
        distance > nose,  # align_path
        near_goal and not rotating,
        rotating,
        speed_squared,
        turn,
    )  # fmt: skip


@jit
def _followed(
    parameters: Parameters, grid: CostGrid, plan: Poses, pose: Planar, from_plan: Planar
) -> tuple[int, Poses]:
    """Return where the plan's part near the robot begins, and that part in the costmap's frame.

    It begins with the first pose that is near the robot, not looking further along the plan than
    ``prune_distance``, and goes on to the first pose that is too far ahead.
    """
    x, y, _ = composed(inverted(from_plan), pose)
    reach = max(grid.costs.shape) * grid.resolution / 2.0
    behind, ahead = (
        min(reach, parameters.prune_distance),
        min(reach, parameters.forward_prune_distance),
    )
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
    near = np.empty((end - begin, 3))
    turn = from_plan[2]
    c, s = math.cos(turn), math.sin(turn)
    for i in range(end - begin):
        pose_x, pose_y, yaw = plan[begin + i]
        near[i, 0] = from_plan[0] + c * pose_x - s * pose_y
        near[i, 1] = from_plan[1] + s * pose_x + c * pose_y
        near[i, 2] = yaw + turn
    return begin, near
