"""The planner server: paths over the global costmap, as an action.

The planner itself is in ``navfn``.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionServer, GoalHandle, Status
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import duration_message
from sim.nav2 import navfn
from sim.nav2.costmap import INSCRIBED, LETHAL, point_costs
from sim.nav2.costmap_node import GlobalCostmap
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.messages import pose_yaw
from sim.nav2.paths import PATH, path_bytes, path_message, path_poses

_POSE_ACTION = "nav2_msgs/action/ComputePathToPose"
_POSES_ACTION = "nav2_msgs/action/ComputePathThroughPoses"
_PoseResult = message_class(f"{_POSE_ACTION}_Result")
_PosesResult = message_class(f"{_POSES_ACTION}_Result")
_WAIT_NS = 10 * MILLISECOND  # period of the tests whether a cleared costmap is current again

Poses = NDArray[np.float64]  # shape (n, 3): x [m], y [m], yaw [rad]


class PlannerServer(LifecycleNode):
    """Answers ``compute_path_to_pose`` and ``compute_path_through_poses``.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    costmap
        The global costmap; it is configured and activated together with this node.
    latency_ns
        From a goal's acceptance to its path.
    """

    def __init__(self, domain: Domain, costmap: GlobalCostmap, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/planner_server", latency_ns=latency_ns)
        self._costmap = costmap
        self._goal: GoalHandle | None = None  # the latest; it ends the previous one

    def is_ready(self) -> bool:
        """Return whether the global costmap can start."""
        return self._costmap.is_ready()

    def on_configure(self) -> None:
        """Configure the costmap and offer the actions."""
        self._costmap.configure()
        self._plan = self.create_publisher(PATH, "/plan", qos.RELIABLE)
        self.create_service("nav2_msgs/srv/IsPathValid", "/is_path_valid", self._is_path_valid)
        for action, name, to_goals, result in (
            (_POSE_ACTION, "/compute_path_to_pose", lambda goal: [goal.goal], _PoseResult),
            (_POSES_ACTION, "/compute_path_through_poses", lambda goal: goal.goals, _PosesResult),
        ):
            ActionServer(self, action, name, self._taker(to_goals, result), GoalHandle.canceled)

    def on_activate(self) -> None:
        """Activate the costmap."""
        self._costmap.activate()

    def _taker(
        self, to_goals: Callable[[Any], list[Any]], result: type[Any]
    ) -> Callable[[GoalHandle], None]:
        """Return an action's callback for a new goal."""

        def take(handle: GoalHandle) -> None:
            if self._goal is not None and self._goal.status is Status.EXECUTING:
                self._goal.abort()
            self._goal = handle
            self._serve(handle, to_goals(handle.goal), result)

        return take

    def _serve(self, handle: GoalHandle, goals: list[Any], result: type[Any]) -> None:
        """Plan as soon as the costmap is current, unless the goal has ended by then."""
        if handle.status is not Status.EXECUTING:
            return
        if not self._costmap.is_current:
            self.call_later(_WAIT_NS, self._serve, handle, goals, result)
            return
        start = _pose(handle.goal.start) if handle.goal.use_start else self._costmap.robot_pose()
        poses = self._path(start, [_pose(goal) for goal in goals])
        if poses is None:
            handle.abort()
            return
        frame = self._costmap.frame
        self._plan.publish_serialized(path_bytes(self.now_ns, frame, poses))
        path = path_message(self.now_ns, frame, poses)
        handle.succeed(result(path, duration_message(self.latency_ns)))

    def _path(self, start: Pose2D | None, goals: list[Pose2D]) -> Poses | None:
        """Return a path through all goals; None, and a warning, if there is none."""
        if start is None:
            self.warn("Could not get the robot's pose")
            return None
        legs = []
        for goal in goals:
            points = navfn.plan(self._costmap.grid, (start.x, start.y), (goal.x, goal.y))
            if points is None:
                self.warn(
                    f"GridBased: failed to create a plan from ({start.x:.2f}, {start.y:.2f}) "
                    f"to ({goal.x:.2f}, {goal.y:.2f})"
                )
                return None
            leg = np.column_stack([points, np.zeros(len(points))])
            leg[-1, 2] = goal.yaw  # NavFn's paths have no orientation but the goal's
            legs.append(leg)
            start = goal
        return np.vstack(legs) if legs else None

    def _is_path_valid(self, path: Any) -> bool:
        """Return whether a ``nav_msgs/msg/Path`` is free from where the robot is on."""
        poses, robot = path_poses(path), self._costmap.robot_pose()
        if robot is None or not len(poses):
            return False
        nearest = np.argmin(np.hypot(poses[:, 0] - robot.x, poses[:, 1] - robot.y))
        costs = point_costs(self._costmap.grid, *poses[nearest:, :2].T)
        return not np.isin(costs, (INSCRIBED, LETHAL)).any()


def _pose(stamped: Any) -> Pose2D:
    position = stamped.pose.position
    return Pose2D(position.x, position.y, pose_yaw(stamped.pose))
