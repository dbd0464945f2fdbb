"""The planner server: paths over the global costmap, as an action.

The planner itself is in ``navfn``.
"""

from typing import Any

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionServer, GoalHandle, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.middleware.geometry import Pose2D, pose_yaw
from sim.middleware.stamps import duration_message
from sim.nav2 import navfn
from sim.nav2.actions import leave_unserved
from sim.nav2.costmap_node import GlobalCostmap
from sim.nav2.lifecycle import LifecycleNode, nothing
from sim.nav2.paths import PATH, Poses, path_bytes, path_message

_ACTION = "nav2_msgs/action/ComputePathToPose"
_Result = message_class(f"{_ACTION}_Result")
_WAIT_NS = 10 * MILLISECOND  # period of the tests whether a cleared costmap is current again


class PlannerServer(LifecycleNode):
    """Answers ``compute_path_to_pose``.

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
        self.create_service("nav2_msgs/srv/IsPathValid", "/is_path_valid", nothing)
        ActionServer(self, _ACTION, "/compute_path_to_pose", self._on_goal, GoalHandle.canceled)
        leave_unserved(self, ["compute_path_through_poses"])

    def on_activate(self) -> None:
        """Activate the costmap."""
        self._costmap.activate()

    def _on_goal(self, handle: GoalHandle) -> None:
        if self._goal is not None and self._goal.status is GoalStatus.EXECUTING:
            self._goal.abort()
        self._goal = handle
        self._serve(handle)

    def _serve(self, handle: GoalHandle) -> None:
        """Plan as soon as the costmap is current, unless the goal has ended by then."""
        if handle.status is not GoalStatus.EXECUTING:
            return
        if not self._costmap.is_current:
            self.call_later(_WAIT_NS, self._serve, handle)
            return
        start = _pose(handle.goal.start) if handle.goal.use_start else self._costmap.robot_pose()
        poses = self._path(start, _pose(handle.goal.goal))
        if poses is None:
            handle.abort()
            return
        frame = self._costmap.frame
        self._plan.publish_serialized(path_bytes(self.now_ns, frame, poses))
        path = path_message(self.now_ns, frame, poses)
        handle.succeed(_Result(path, duration_message(self.latency_ns)))

    def _path(self, start: Pose2D | None, goal: Pose2D) -> Poses | None:
        """Return a path to a goal; None, and a warning, if there is none."""
        if start is None:
            self.warn("Could not get the robot's pose")
            return None
        points = navfn.plan(self._costmap.grid, (start.x, start.y), (goal.x, goal.y))
        if points is None:
            self.warn(
                f"GridBased: failed to create a plan from ({start.x:.2f}, {start.y:.2f}) "
                f"to ({goal.x:.2f}, {goal.y:.2f})"
            )
            return None
        path = np.column_stack([points, np.zeros(len(points))])
        path[-1, 2] = goal.yaw  # NavFn's paths have no orientation but the goal's
        return path


def _pose(stamped: Any) -> Pose2D:
    position = stamped.pose.position
    return Pose2D(position.x, position.y, pose_yaw(stamped.pose))
