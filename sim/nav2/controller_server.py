"""The controller server: follows the path it is given, 20 times a second.

The velocity comes from ``dwb``. This module has the action, the topics, and the checkers that
decide whether the robot makes progress and whether it has arrived.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import GoalHandle, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Timer
from sim.middleware.geometry import Pose2D, wrap_angle
from sim.middleware.stamps import stamp_ns
from sim.middleware.tf import TransformBuffer, TransformError
from sim.nav2.actions import SimpleActionServer
from sim.nav2.costmap_node import LocalCostmap
from sim.nav2.dwb import Cycle, LocalPlanner
from sim.nav2.dwb_sampling import Parameters
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.messages import TWIST, twist_bytes, twist_message
from sim.nav2.parameters import of_node
from sim.nav2.paths import PATH, length_ahead, path_bytes, path_poses, sent_poses
from sim.nav2.rotation_shim import RotationShim

_Feedback = message_class("nav2_msgs/action/FollowPath_Feedback")

PERIOD_NS = 50 * MILLISECOND
FAILURE_TOLERANCE_NS = 300 * MILLISECOND
MIN_X_VELOCITY = 0.001  # slower counts as stopped [m/s]
MIN_THETA_VELOCITY = 0.001  # [rad/s]

# Advertised and silent: DWB's debug topics have 20 MB per second, and publish_cost_grid_pc is off.
SILENT = {
    "/evaluation": "dwb_msgs/msg/LocalPlanEvaluation",
    "/marker": "visualization_msgs/msg/MarkerArray",
    "/cost_cloud": "sensor_msgs/msg/PointCloud2",
}


class ProgressChecker:
    """Nav2's ``SimpleProgressChecker``: a distance within a time, or the robot is stuck."""

    RADIUS_M = 0.5
    ALLOWANCE_NS = 10 * SECOND

    def __init__(self) -> None:
        self._from: Pose2D | None = None
        self._since_ns = 0

    def check(self, pose: Pose2D, now_ns: int) -> bool:
        """Return whether the robot still makes progress."""
        if self._from is None or pose.distance_to(self._from) > self.RADIUS_M:
            self._from, self._since_ns = pose, now_ns
        return now_ns - self._since_ns <= self.ALLOWANCE_NS


class GoalChecker:
    """Nav2's ``SimpleGoalChecker``, stateful: after reaching the position, only the yaw counts."""

    XY_TOLERANCE_M = 0.25
    YAW_TOLERANCE_RAD = 0.25

    def __init__(self) -> None:
        self._near = False

    def is_reached(self, pose: Pose2D, goal: Pose2D) -> bool:
        """Return whether the robot has arrived; both poses are in the same frame."""
        self._near |= pose.distance_to(goal) <= self.XY_TOLERANCE_M
        return self._near and abs(wrap_angle(goal.yaw - pose.yaw)) <= self.YAW_TOLERANCE_RAD


class _ControllerError(Exception):
    """The path cannot be followed any further."""


class ControllerServer(LifecycleNode):
    """Serves ``/follow_path``; a new goal replaces the running one without a stop.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    costmap
        The local costmap; it is configured and activated together with this node.
    transforms
        Transforms from the path's frame into the costmap's.
    parameters
        Of the DWB planner.
    faces_paths
        Whether the robot turns towards a new path before DWB takes over (`rotation_shim`).
    """

    def __init__(
        self, domain: Domain, costmap: LocalCostmap, transforms: TransformBuffer, *,
        parameters: Parameters | None = None, faces_paths: bool = True, latency_ns: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(domain, "/controller_server", latency_ns=latency_ns)
        self._costmap = costmap
        self._transforms = transforms
        self._planner = RotationShim(parameters) if faces_paths else LocalPlanner(parameters)
        for name, setting in of_node("controller_server").items():
            self.declare_parameter(
                name,
                getattr(self._planner.parameters, setting.field),
                partial(setting.checked, name),
                partial(self._on_parameter, setting.field),
            )
        self._progress = ProgressChecker()
        self._goal_checker = GoalChecker()
        self._velocity = (0.0, 0.0)
        self._loop: Timer
        self._valid_ns = 0  # time of the last valid velocity

    def is_ready(self) -> bool:
        """Return whether the local costmap can start."""
        return self._costmap.is_ready()

    def on_configure(self) -> None:
        """Configure the costmap and open the topics."""
        self._costmap.configure()
        self._commands = self.create_publisher(TWIST, "/cmd_vel_nav", qos.RELIABLE)
        self._received = self.create_publisher(PATH, "/received_global_plan", qos.RELIABLE)
        self._transformed = self.create_publisher(PATH, "/transformed_global_plan", qos.RELIABLE)
        self._local = self.create_publisher(PATH, "/local_plan", qos.RELIABLE)
        for topic, msgtype in SILENT.items():
            self.create_publisher(msgtype, topic, qos.RELIABLE)
        self.create_subscription("nav_msgs/msg/Odometry", "/odom", self._on_odometry, qos.SYSTEM)
        self.create_subscription("nav2_msgs/msg/SpeedLimit", "/speed_limit", self._on_speed_limit)
        self._goals = SimpleActionServer(self, "follow_path", self._start)

    def on_activate(self) -> None:
        """Activate the costmap."""
        self._costmap.activate()

    def _on_odometry(self, odometry: Any) -> None:
        linear, angular = odometry.twist.twist.linear.x, odometry.twist.twist.angular.z
        self._velocity = (
            linear if abs(linear) > MIN_X_VELOCITY else 0.0,
            angular if abs(angular) > MIN_THETA_VELOCITY else 0.0,
        )

    def _on_speed_limit(self, message: Any) -> None:
        self._planner.limit_speed(message.speed_limit, percentage=message.percentage)

    def _on_parameter(self, field: str, value: float) -> None:
        changed: dict[str, Any] = {field: value}  # whole where the field is
        self._planner.configure(self._planner.parameters._replace(**changed))

    def _start(self) -> None:
        self.info("Received a goal, begin computing control effort.")
        self._progress = ProgressChecker()
        self._valid_ns = self.now_ns
        self._path = np.empty((0, 3))
        self._take_path()
        self._loop = self.create_timer(PERIOD_NS, self._cycle, phase_ns=0)

    def _take_path(self) -> None:
        path = self._goals.current.goal.path
        self._frame = path.header.frame_id
        path_before, self._path = self._path, path_poses(path)
        # With every path, once a second, Nav2 resets that the robot was near the goal; see
        # docs/explanation/navigation.md for the effect.
        same_goal = np.array_equal(path_before[-1:], self._path[-1:])
        if len(self._path):
            self._path_end = Pose2D(*self._path[-1].tolist())
        if not same_goal:
            self._goal_checker = GoalChecker()
        self._planner.set_plan(self._path, same_goal=same_goal)
        self._stamp_ns = stamp_ns(path.header.stamp)
        self._sent = sent_poses(path)
        self._publish_plan()

    def _cycle(self) -> None:
        if self._goals.current.status is GoalStatus.CANCELING:
            self._end(GoalHandle.canceled)
            return
        if not self._costmap.is_current:
            return
        if self._goals.is_preempted:
            self.info("Passing new path to controller.")
            self._goals.accept_pending()
            self._take_path()
        try:
            reached = self._control()
        except _ControllerError as error:
            self.error(str(error))
            self._end(GoalHandle.abort)
        else:
            if reached:
                self.info("Reached the goal!")
                self._end(GoalHandle.succeed)

    def _control(self) -> bool:
        """Send one velocity and return whether the goal is reached."""
        now_ns, pose, grid = self.now_ns, self._costmap.robot_pose(), self._costmap.grid
        if pose is None:
            raise _ControllerError("Failed to obtain robot pose")
        if not self._progress.check(pose, now_ns):
            raise _ControllerError("Failed to make progress")
        if not len(self._path):
            raise _ControllerError("Path is empty.")
        try:
            from_path = self._transforms.lookup(grid.frame, self._frame)
        except TransformError as error:
            raise _ControllerError(str(error)) from None
        cycle = self._planner.compute(grid.cost_grid, pose, self._velocity, from_path)
        self._publish_plans(now_ns, cycle, grid.frame)
        if cycle.twist is not None:
            self._valid_ns = now_ns
        elif now_ns - self._valid_ns > FAILURE_TOLERANCE_NS:
            raise _ControllerError("Controller patience exceeded")
        else:
            self.warn("No valid trajectories out of the sampled ones!")
        twist = cycle.twist or (0.0, 0.0)
        if self._goals.feedback_is_received:
            robot = from_path.inverse().compose(pose)
            distance = length_ahead(self._path, robot.x, robot.y)
            self._goals.current.publish_feedback(_Feedback(distance, abs(twist[0])))
        self._commands.publish(twist_message(*twist), twist_bytes(*twist))
        return self._goal_checker.is_reached(pose, from_path.compose(self._path_end))

    def _publish_plan(self) -> None:
        plan = self._sent[len(self._sent) - len(self._planner.plan) :]
        self._received.publish_serialized(path_bytes(self._stamp_ns, self._frame, plan))

    def _publish_plans(self, now_ns: int, cycle: Cycle, frame: str) -> None:
        self._publish_plan()
        self._transformed.publish_serialized(path_bytes(now_ns, frame, cycle.plan))
        self._local.publish_serialized(path_bytes(now_ns, frame, cycle.trajectory))

    def _end(self, answer: Callable[[GoalHandle], None]) -> None:
        self._loop.cancel()
        self._commands.publish(twist_message(0.0, 0.0), twist_bytes(0.0, 0.0))
        self._goals.end(answer)
