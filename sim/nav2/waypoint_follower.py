"""The waypoint follower: visits poses one after the other through ``/navigate_to_pose``."""

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

PAUSE_NS = 200 * MILLISECOND


class WaypointFollower(LifecycleNode):
    """Serves ``/follow_waypoints``; a waypoint that cannot be reached is left out.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    """

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/waypoint_follower", latency_ns=latency_ns)
        self._under_way: GoalHandle | None = None

    def on_configure(self) -> None:
        """Open the actions."""
        self._client = ActionClient(self, "nav2_msgs/action/NavigateToPose", "/navigate_to_pose")
        ActionServer(
            self,
            "nav2_msgs/action/FollowWaypoints",
            "/follow_waypoints",
            self._on_goal,
            self._on_cancel,
        )

    def _on_goal(self, goal: GoalHandle) -> None:
        self._visit(goal, 0, [])

    def _on_cancel(self, _goal: GoalHandle) -> None:
        if self._under_way is not None:
            self._under_way.cancel()

    def _visit(self, goal: GoalHandle, index: int, missed: list[int]) -> None:
        if goal.status is Status.CANCELING:
            goal.canceled()
            return
        if index == len(goal.goal.poses):
            goal.succeed(_Result(np.array(missed, dtype=np.int32)))
            return
        goal.publish_feedback(_Feedback(index))

        def arrived(status: Status, _result: Any) -> None:
            failed = [] if status is Status.SUCCEEDED else [index]
            self.call_later(PAUSE_NS, self._visit, goal, index + 1, missed + failed)

        self._under_way = self._client.send_goal(
            _NavigateToPose(goal.goal.poses[index], ""), arrived
        )
