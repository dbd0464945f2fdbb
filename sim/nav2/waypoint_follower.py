"""The waypoint follower: visits poses one after the other through ``/navigate_to_pose``."""

from collections.abc import Callable
from typing import Any

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.middleware.action import ActionClient, ActionServer, GoalHandle, Status
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.nav2.lifecycle import LifecycleNode

_Feedback = message_class("nav2_msgs/action/FollowWaypoints_Feedback")
_NavigateToPose = message_class("nav2_msgs/action/NavigateToPose_Goal")
_Result = message_class("nav2_msgs/action/FollowWaypoints_Result")

LOOP_NS = 50 * MILLISECOND
PAUSE_NS = 200 * MILLISECOND  # at a waypoint that was reached


class WaypointFollower(LifecycleNode):
    """Serves ``/follow_waypoints``; a waypoint that cannot be reached is left out.

    A new goal takes the place of the running one at once.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    """

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/waypoint_follower", latency_ns=latency_ns)
        self._goal: GoalHandle | None = None
        self._index = 0  # of the waypoint that is being visited
        self._missed: list[int] = []
        self._drive: GoalHandle | None = None  # to that waypoint

    def on_configure(self) -> None:
        """Open the actions."""
        self._client = ActionClient(self, "nav2_msgs/action/NavigateToPose", "/navigate_to_pose")
        ActionServer(self, "nav2_msgs/action/FollowWaypoints", "/follow_waypoints", self._on_goal)

    def _on_goal(self, goal: GoalHandle) -> None:
        if self._goal is not None:
            self._end(self._goal.abort)
        self._goal, self._index, self._missed, self._drive = goal, 0, [], None
        if goal.goal.poses:
            self._cycle(goal)
        else:
            self.error("There is no waypoint in the goal; send at least one.")
            self._end(goal.abort)

    def _cycle(self, goal: GoalHandle) -> None:
        """Send the robot to the next waypoint, or check its progress."""
        if goal is not self._goal:
            return
        if goal.status is Status.CANCELING:
            if self._drive is not None:
                self._drive.cancel()
            self._end(goal.canceled)
            return
        if self._index == len(goal.goal.poses):
            self._end(goal.succeed)
            return
        if self._drive is None:
            pose = goal.goal.poses[self._index]
            self._drive = self._client.send_goal(_NavigateToPose(pose, ""), lambda *_: None)
        goal.publish_feedback(_Feedback(self._index))
        wait_ns = LOOP_NS if self._drive.is_active else self._arrive(self._drive.status)
        self.call_later(wait_ns, self._cycle, goal)

    def _arrive(self, status: Status) -> int:
        """Record how a drive ended and choose the next waypoint; return when [ns from now]."""
        reached = status is Status.SUCCEEDED
        if not reached:
            self._missed.append(self._index)
        self._index += 1
        self._drive = None
        return PAUSE_NS if reached else LOOP_NS

    def _end(self, answer: Callable[[Any], None]) -> None:
        self._goal = None
        answer(_Result(np.array(self._missed, dtype=np.int32)))
