"""The rotation shim: turn towards a new path on the spot before the local planner drives off.

As ``nav2_rotation_shim_controller`` on Humble, around DWB. Without it DWB swings out while it
turns, and a robot that swings out between the pillars of this world ends beside one, where the
collision monitor's stop zone holds it. Why, and what it changes: docs/navigation.md.
"""

import math
from typing import NamedTuple

import numpy as np

from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D, wrap_angle
from sim.nav2.dwb import CostGrid, Cycle, LocalPlanner, Parameters
from sim.nav2.paths import Poses


class ShimParameters(NamedTuple):
    """Names as in the original, which has 0.785 rad, 0.5 m and 1.8 rad/s by default."""

    angular_dist_threshold: float = 0.35  # heading errors above this are turned away first [rad]
    forward_sampling_distance: float = 0.3  # where on the path the heading is looked up [m]
    rotate_to_heading_angular_vel: float = 1.0  # [rad/s]
    max_angular_accel: float = 3.2  # [rad/s^2]


class RotationShim(LocalPlanner):
    """DWB that first faces each new path.

    The footprint is a circle, so turning on the spot needs no look at the costmap.

    Parameters
    ----------
    dwb, shim
        Of the planner, and of the turn before it takes over.
    period_ns
        From one call of ``compute`` to the next.
    """

    def __init__(
        self, dwb: Parameters | None = None, shim: ShimParameters | None = None, *, period_ns: int
    ) -> None:
        super().__init__(dwb)
        self._shim = shim or ShimParameters()
        self._period_s = period_ns / SECOND
        self._facing = False  # still to be checked whether the robot faces the plan

    def set_plan(self, plan: Poses) -> None:
        """Follow ``plan`` of shape (n, 3) from now on, after turning towards it."""
        super().set_plan(plan)
        self._facing = True

    def compute(
        self, grid: CostGrid, pose: Pose2D, velocity: tuple[float, float], from_plan: Pose2D
    ) -> Cycle:
        """Choose the next velocity; parameters are those of `LocalPlanner.compute`."""
        error = self._heading_error(from_plan.inverse().compose(pose)) if self._facing else 0.0
        self._facing = abs(error) > self._shim.angular_dist_threshold
        if not self._facing:
            return super().compute(grid, pose, velocity, from_plan)
        step = self._shim.max_angular_accel * self._period_s
        wanted = math.copysign(self._shim.rotate_to_heading_angular_vel, error)
        turning = min(max(wanted, velocity[1] - step), velocity[1] + step)
        return Cycle((0.0, turning), self.followed(pose, grid, from_plan), np.empty((0, 3)))

    def _heading_error(self, robot: Pose2D) -> float:
        """Return the bearing of the path a little ahead; 0 if the path ends before that."""
        distances = np.hypot(self.plan[:, 0] - robot.x, self.plan[:, 1] - robot.y)
        closest = int(np.argmin(distances))
        ahead = np.flatnonzero(distances[closest:] >= self._shim.forward_sampling_distance)
        if not len(ahead):
            return 0.0
        x, y, _ = self.plan[closest + ahead[0]].tolist()
        return wrap_angle(math.atan2(y - robot.y, x - robot.x) - robot.yaw)
