"""The client: sends AMCL the initial pose, and Nav2 the goals of a patrol.

It is ``BasicNavigator`` of ``nav2_simple_commander``, which opens a client for every action.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.goal_progress import GoalOutcome, GoalProgress
from sim.middleware import qos
from sim.middleware.action import GoalHandle, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Timer
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.nav2 import actions
from sim.nav2.messages import POSE_ESTIMATE, pose_estimate, pose_stamped

_NavigateToPose = message_class("nav2_msgs/action/NavigateToPose_Goal")


_OTHER_ACTIONS = (
    *("navigate_through_poses", "follow_waypoints", "follow_path", "compute_path_to_pose"),
    *("compute_path_through_poses", "smooth_path", "spin", "backup", "assisted_teleop"),
)
_SERVICES = (
    "/map_server/load_map",
    "/global_costmap/clear_entirely_global_costmap",
    "/local_costmap/clear_entirely_local_costmap",
    "/global_costmap/get_costmap",
    "/local_costmap/get_costmap",
)
_OUTCOMES: dict[GoalStatus, GoalOutcome] = {
    GoalStatus.SUCCEEDED: "succeeded",
    GoalStatus.ABORTED: "aborted",
    GoalStatus.CANCELED: "canceled",
}


class BasicNavigator(Node):
    """Sends goals one after the other.

    Parameters
    ----------
    domain, latency_ns
        As for `Node`.

    Attributes
    ----------
    results
        One entry for each goal sent so far.
    is_over
        Whether the last goal has been reached, or one has failed.
    """

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/basic_navigator", endpoints="P", latency_ns=latency_ns)
        self.results: list[GoalProgress] = []
        self.is_over = False
        self._localized = False
        self._initial_pose = self.create_publisher(POSE_ESTIMATE, "/initialpose")
        self.create_subscription(POSE_ESTIMATE, "/amcl_pose", self._on_amcl_pose, qos.LATCHED)
        self._client = actions.client(self, "navigate_to_pose")
        for action in _OTHER_ACTIONS:
            actions.client(self, action)
        for service in _SERVICES:
            self.create_client(service)

    def set_initial_pose(self, pose: Pose2D) -> None:
        """Publish the robot's pose in the map once a second, until AMCL answers."""
        self._localized = False

        def publish() -> None:
            if self._localized:
                timer.cancel()
                return
            self._initial_pose.publish(pose_estimate(self.now_ns, pose, np.zeros(36)))

        timer: Timer = self.create_timer(SECOND, publish, phase_ns=0)

    def follow(
        self, goals: Sequence[Pose2D], on_accepted: Callable[[int], None] = lambda _: None
    ) -> None:
        """Drive to poses in the map, in order; a goal that is not reached ends the patrol.

        Parameters
        ----------
        goals
            The poses.
        on_accepted
            Called with the number of each goal, from 1, when it has been accepted.
        """
        if not goals:
            self.is_over = True
            return
        goal, *others = goals

        def on_feedback(feedback: Any) -> None:
            result.number_of_recoveries = int(feedback.number_of_recoveries)

        def on_result(status: GoalStatus, _result: Any) -> None:
            result.end(self.now_ns, _OUTCOMES[status])
            self.follow(others if status is GoalStatus.SUCCEEDED else [], on_accepted)

        pose = pose_stamped(self.now_ns, "map", goal.x, goal.y, goal.yaw)
        handle: GoalHandle = self._client.send_goal(
            _NavigateToPose(pose, ""), on_result, on_feedback
        )
        result = GoalProgress(handle.accepted_ns)
        self.results.append(result)
        on_accepted(len(self.results))

    def _on_amcl_pose(self, _pose: Any) -> None:
        self._localized = True
