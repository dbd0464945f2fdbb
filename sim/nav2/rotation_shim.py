"""The rotation shim: turn in place towards a new path before the local planner drives.

As ``nav2_rotation_shim_controller`` on Humble, around DWB. Without it DWB swings out while it
turns, and a robot that swings out between the pillars of this world ends beside one, where the
collision monitor's stop zone holds it. Why, and what it changes: docs/explanation/navigation.md.
"""

import math

import numpy as np

from sim.middleware.geometry import Pose2D, wrap_angle
from sim.nav2.costmap import CostGrid
from sim.nav2.dwb import Cycle, LocalPlanner
from sim.nav2.dwb_sampling import Parameters
from sim.nav2.paths import Poses

# Names as in the original, which has 0.785 rad and 0.5 m by default.
ANGULAR_DIST_THRESHOLD = 0.35  # heading errors above this are turned away first [rad]
FORWARD_SAMPLING_DISTANCE = 0.4  # where on the path the heading is looked up [m]


class RotationShim(LocalPlanner):
    """DWB that first faces each new path, turning as fast as DWB may.

    The footprint is a circle, so turning in place needs no collision test. The velocity smoother
    limits the acceleration.

    Parameters
    ----------
    dwb
        Parameters of the planner.
    """

    def __init__(self, dwb: Parameters | None = None) -> None:
        super().__init__(dwb)
        self._facing = False  # still to be checked whether the robot faces the plan

    def set_plan(self, plan: Poses, *, same_goal: bool = False) -> None:
        """Follow ``plan`` of shape (n, 3) from now on, after turning towards it."""
        super().set_plan(plan, same_goal=same_goal)
        self._facing = True

    def compute(
        self, grid: CostGrid, pose: Pose2D, velocity: tuple[float, float], from_plan: Pose2D
    ) -> Cycle:
        """Choose the next velocity; parameters are those of `LocalPlanner.compute`."""
        if self._facing:
            near = self.followed(pose, grid, from_plan)
            error = self._heading_error(pose, near)
            self._facing = abs(error) > ANGULAR_DIST_THRESHOLD
            if self._facing:
                turning = math.copysign(self._limited.max_vel_theta, error)
                return Cycle((0.0, turning), near, near[:0])
        return super().compute(grid, pose, velocity, from_plan)

    def _heading_error(self, robot: Pose2D, plan: Poses) -> float:
        """Return the bearing of the path at the look-ahead distance; 0 if the path ends before."""
        distances = np.hypot(plan[:, 0] - robot.x, plan[:, 1] - robot.y)
        closest = int(np.argmin(distances)) if len(plan) else 0
        ahead = np.flatnonzero(distances[closest:] >= FORWARD_SAMPLING_DISTANCE)
        if not len(ahead):
            return 0.0
        x, y, _ = plan[closest + ahead[0]].tolist()
        return wrap_angle(math.atan2(y - robot.y, x - robot.x) - robot.yaw)
