"""The DWB local planner: samples velocities, simulates each one, and scores them by critics.

Sampling and rollout are in ``dwb_sampling``, the critics in ``dwb_critics``. This module keeps the
state between cycles, as Nav2 does on Humble. Topics and actions belong to the controller server.
"""

import math
from dataclasses import dataclass

import numpy as np

from sim.jit import jit
from sim.middleware.geometry import Pose2D, wrap_angle
from sim.nav2.dwb_critics import CostGrid, Critics, Scoring, map_plan, search
from sim.nav2.dwb_sampling import Parameters
from sim.nav2.paths import Poses


@dataclass(frozen=True, slots=True)
class Cycle:
    """Result of one control cycle; poses are in the costmap's frame."""

    twist: tuple[float, float] | None  # [m/s, rad/s]; None if no trajectory is legal
    plan: Poses  # the part of the plan that was followed
    trajectory: Poses  # the rollout of ``twist``
    scoring: Scoring | None = None  # input of the critics; None if they were not called


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
        parameters = self._limited
        near = self.followed(pose, grid, from_plan)
        if not len(near):
            return Cycle(None, near, near)
        goal = from_plan.compose(Pose2D(*self.plan[-1]))
        critics = self._prepare(grid, pose, velocity, goal, near)
        scoring = Scoring(parameters, grid, (pose.x, pose.y, pose.yaw), velocity, critics)
        forward, turning, rollout = search(*scoring)
        legal = not math.isnan(forward)
        self._turns.debrief((forward, turning) if legal else (0.0, 0.0), pose)
        return Cycle((forward, turning) if legal else None, near, rollout, scoring)

    def followed(self, pose: Pose2D, grid: CostGrid, from_plan: Pose2D) -> Poses:
        """Drop the plan behind the robot; return the part to follow, in the costmap's frame."""
        robot = from_plan.inverse().compose(pose)
        reach = max(grid.costs.shape) * grid.resolution / 2.0
        base, turn = self._base, from_plan.yaw
        begin, near = _followed(
            self.plan, robot.x, robot.y, min(reach, base.prune_distance),
            min(reach, base.forward_prune_distance), base.prune_distance,
            from_plan.x, from_plan.y, turn, math.cos(turn), math.sin(turn),
        )  # fmt: skip
        self.plan = self.plan[begin:]
        return near

    def _prepare(
        self,
        grid: CostGrid,
        pose: Pose2D,
        velocity: tuple[float, float],
        goal: Pose2D,
        plan: Poses,
    ) -> Critics:
        parameters = self._limited
        distance = pose.distance_to(goal)
        speed_squared = velocity[0] ** 2
        self._near_goal |= distance <= parameters.xy_goal_tolerance
        self._rotating |= self._near_goal and speed_squared <= parameters.trans_stopped_velocity**2
        ahead = math.atan2(goal.y - pose.y, goal.x - pose.x)
        path_distance, goal_x, goal_y, nose_x, nose_y = map_plan(
            grid,
            plan,
            parameters.forward_point_distance * math.cos(ahead),
            parameters.forward_point_distance * math.sin(ahead),
        )
        return Critics(
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
def _followed(
    plan: Poses,
    x: float,
    y: float,
    behind: float,
    ahead: float,
    prune_distance: float,
    shift_x: float,
    shift_y: float,
    turn: float,
    c: float,
    s: float,
) -> tuple[int, Poses]:
    """Return where the plan's part near the robot begins, and that part, moved.

    It begins with the first pose nearer than ``behind``, not looking further along the plan than
    ``prune_distance``, and goes on to the first pose that is farther than ``ahead`` [m]. It is
    turned by ``turn``, of which ``c`` and ``s`` are cosine and sine, and shifted.
    """
    begin, along = 0, 0.0
    while begin < len(plan) and math.hypot(plan[begin, 0] - x, plan[begin, 1] - y) >= behind:
        if begin > 0:
            along += math.hypot(
                plan[begin, 0] - plan[begin - 1, 0], plan[begin, 1] - plan[begin - 1, 1]
            )
        if along > prune_distance:
            break
        begin += 1
    end = begin
    while end < len(plan) and math.hypot(plan[end, 0] - x, plan[end, 1] - y) <= ahead:
        end += 1
    moved = np.empty((end - begin, 3))
    for i in range(end - begin):
        pose = plan[begin + i]
        moved[i, 0] = shift_x + c * pose[0] - s * pose[1]
        moved[i, 1] = shift_y + s * pose[0] + c * pose[1]
        moved[i, 2] = pose[2] + turn
    return begin, moved
