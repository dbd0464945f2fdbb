"""The behaviour server: short blind manoeuvres that may free a stuck robot.

As on Humble, velocities go straight to ``/cmd_vel``, past velocity smoother and collision
monitor. A collision test ahead in the local costmap protects the robot.
"""

import enum
import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionServer, GoalHandle, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Timer
from sim.middleware.geometry import Pose2D, wrap_angle
from sim.middleware.stamps import duration_message, stamp_ns
from sim.middleware.tf import TransformBuffer, TransformError
from sim.nav2.actions import leave_unserved
from sim.nav2.costmap import LETHAL, Costmap2D, footprint_cost
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.messages import TWIST, twist_message

_BackUpFeedback = message_class("nav2_msgs/action/BackUp_Feedback")
_SpinFeedback = message_class("nav2_msgs/action/Spin_Feedback")
_WaitFeedback = message_class("nav2_msgs/action/Wait_Feedback")

CYCLE_HZ = 10
LOOK_AHEAD_S = 2.0
ODOM_FRAME = "odom"
BASE_FRAME = "base_link"
MAX_ROTATIONAL_VEL = 1.0  # [rad/s]
MIN_ROTATIONAL_VEL = 0.4  # [rad/s]
ROTATIONAL_ACC_LIM = 3.2  # [rad/s^2]
_REACHED_RAD = 1e-6


class BehaviorStatus(enum.Enum):
    """Status of a behaviour after one cycle."""

    RUNNING = enum.auto()
    SUCCEEDED = enum.auto()
    FAILED = enum.auto()


@dataclass(frozen=True, slots=True)
class BehaviorStep:
    """The result of one cycle."""

    outcome: BehaviorStatus
    linear: float = 0.0  # velocity to send while running [m/s]
    angular: float = 0.0  # [rad/s]
    feedback: Any = None


class Surroundings:
    """The robot's pose, and whether other poses are free."""

    def __init__(self, transforms: TransformBuffer) -> None:
        self._transforms = transforms
        self._grid: Costmap2D | None = None

    def on_costmap(self, message: Any) -> None:
        """Store the local costmap."""
        self._grid = Costmap2D.from_message(message)

    def pose(self) -> Pose2D | None:
        """Return the robot's pose in the odometry frame; None while it is not known."""
        try:
            return self._transforms.lookup(ODOM_FRAME, BASE_FRAME)
        except TransformError:
            return None

    def is_clear(self, speed: float, way: float, place: Callable[[float], Pose2D]) -> bool:
        """Return whether the robot's outline will touch no obstacle or unknown space.

        Parameters
        ----------
        speed
            Of the robot, driving or turning.
        way
            Where it is farther away than this, it is not tested.
        place
            Returns where the robot is after a part of its way.
        """
        for cycle in range(int(CYCLE_HZ * LOOK_AHEAD_S)):
            part = speed * (cycle / CYCLE_HZ)
            if way <= abs(part):
                break
            if not self._is_free(place(part)):
                return False
        return True

    def _is_free(self, pose: Pose2D) -> bool:
        return self._grid is not None and footprint_cost(self._grid, pose) < LETHAL


class _Behavior(ABC):
    """One action of the server; ten cycles a second while it runs.

    Parameters
    ----------
    node
        The server.
    surroundings
        The robot's pose and the local costmap.
    """

    name: ClassVar[str]  # of the action, without the slash
    action: ClassVar[str]  # its type, without the package

    def __init__(self, node: LifecycleNode, surroundings: Surroundings) -> None:
        self.node = node
        self.surroundings = surroundings
        self._velocity = node.create_publisher(TWIST, "/cmd_vel", qos.RELIABLE)
        self._goal: GoalHandle | None = None
        self._loop: Timer
        self._deadline_ns: int | None = None
        self._start_ns = 0
        action_type = f"nav2_msgs/action/{self.action}"
        self._result_type = message_class(f"{action_type}_Result")
        ActionServer(node, action_type, f"/{self.name}", self._on_goal)

    @abstractmethod
    def start(self, goal: Any, pose: Pose2D) -> bool:
        """Begin at ``pose`` (odometry frame); False if the goal cannot be carried out."""

    @abstractmethod
    def step(self, pose: Pose2D) -> BehaviorStep:
        """Do one cycle at ``pose`` (odometry frame)."""

    def allow(self, time: Any) -> None:
        """Set the time allowance (``builtin_interfaces/msg/Duration``); none is no limit."""
        allowance_ns = stamp_ns(time)
        self._deadline_ns = self.node.now_ns + allowance_ns if allowance_ns else None

    def is_overdue(self) -> bool:
        """Return whether the time allowance is used up, and log it."""
        if self._deadline_ns is None or self.node.now_ns <= self._deadline_ns:
            return False
        self.node.warn(f"Exceeded time allowance before reaching the {self.action} goal")
        return True

    def _on_goal(self, goal: GoalHandle) -> None:
        if self._goal is not None:  # as in Nav2, a behaviour cannot be preempted: both goals end
            self._end(self._goal.abort)
            goal.abort(self._result())
            return
        self.node.info(f"Running {self.name}")
        self._start_ns = self.node.now_ns
        pose = self.surroundings.pose()
        if pose is None or not self.start(goal.goal, pose):
            self.node.error(f"{self.name} could not be started")
            goal.abort(self._result())
            return
        self._goal = goal
        cycle = functools.partial(self._cycle, goal)
        self._loop = self.node.create_timer(SECOND // CYCLE_HZ, cycle, phase_ns=0)

    def _cycle(self, goal: GoalHandle) -> None:
        pose = self.surroundings.pose()
        if goal.status is GoalStatus.CANCELING:
            self._end(goal.canceled)
            return
        step = self.step(pose) if pose is not None else BehaviorStep(BehaviorStatus.FAILED)
        if step.feedback is not None:
            goal.publish_feedback(step.feedback)
        if step.outcome is BehaviorStatus.RUNNING:
            self.drive(step.linear, step.angular)
        else:
            self._end(goal.succeed if step.outcome is BehaviorStatus.SUCCEEDED else goal.abort)

    def drive(self, linear: float, angular: float) -> None:
        """Send a velocity to the wheels."""
        self._velocity.publish(twist_message(linear, angular))

    def _end(self, answer: Callable[[Any], None]) -> None:
        self._loop.cancel()
        self._goal = None
        self.drive(0.0, 0.0)
        self.node.info(f"{self.name} ended")
        answer(self._result())

    def _result(self) -> Any:
        """Return the time since the start."""
        return self._result_type(duration_message(self.node.now_ns - self._start_ns))


class Spin(_Behavior):
    """Rotates in place by an angle."""

    name = "spin"
    action = "Spin"

    def start(self, goal: Any, pose: Pose2D) -> bool:
        """Begin to turn."""
        self._target = float(goal.target_yaw)
        self._turned = 0.0
        self._yaw = pose.yaw
        self.allow(goal.time_allowance)
        return True

    def step(self, pose: Pose2D) -> BehaviorStep:
        """Turn on, slower towards the end."""
        if self.is_overdue():
            return BehaviorStep(BehaviorStatus.FAILED)
        self._turned += wrap_angle(pose.yaw - self._yaw)
        self._yaw = pose.yaw
        feedback = _SpinFeedback(self._turned)
        remaining = abs(self._target) - abs(self._turned)
        if remaining < _REACHED_RAD:
            return BehaviorStep(BehaviorStatus.SUCCEEDED, feedback=feedback)
        speed = math.sqrt(2.0 * ROTATIONAL_ACC_LIM * remaining)
        speed = min(max(speed, MIN_ROTATIONAL_VEL), MAX_ROTATIONAL_VEL)
        velocity = math.copysign(speed, self._target)
        # Like Nav2, this looks ahead by the angle turned so far, not by the one that remains.
        if not self.surroundings.is_clear(
            velocity, abs(self._turned), lambda angle: Pose2D(pose.x, pose.y, pose.yaw + angle)
        ):
            self.node.warn("Collision Ahead - Exiting Spin")
            return BehaviorStep(BehaviorStatus.FAILED, feedback=feedback)
        return BehaviorStep(BehaviorStatus.RUNNING, angular=velocity, feedback=feedback)


class BackUp(_Behavior):
    """Drives straight back for a distance."""

    name = "backup"
    action = "BackUp"

    def start(self, goal: Any, pose: Pose2D) -> bool:
        """Begin to drive; only straight, and backwards whatever the goal's signs."""
        self._distance, self._speed = -abs(float(goal.target.x)), -abs(float(goal.speed))
        self._from = pose
        self.allow(goal.time_allowance)
        return goal.target.y == goal.target.z == 0.0 and self._distance * self._speed > 0.0

    def step(self, pose: Pose2D) -> BehaviorStep:
        """Drive on."""
        if self.is_overdue():
            return BehaviorStep(BehaviorStatus.FAILED)
        driven = pose.distance_to(self._from)
        feedback = _BackUpFeedback(driven)
        if driven >= abs(self._distance):
            return BehaviorStep(BehaviorStatus.SUCCEEDED, feedback=feedback)
        remaining = abs(self._distance) - driven
        if not self.surroundings.is_clear(
            self._speed, remaining, lambda way: pose.compose(Pose2D(way))
        ):
            self.node.warn(f"Collision Ahead - Exiting {self.action}")
            return BehaviorStep(BehaviorStatus.FAILED, feedback=feedback)
        return BehaviorStep(BehaviorStatus.RUNNING, linear=self._speed, feedback=feedback)


class Wait(_Behavior):
    """Does nothing for a time."""

    name = "wait"
    action = "Wait"

    def start(self, goal: Any, pose: Pose2D) -> bool:  # noqa: ARG002 -- independent of the pose
        """Begin to wait."""
        self._until_ns = self.node.now_ns + stamp_ns(goal.time)
        return True

    def step(self, pose: Pose2D) -> BehaviorStep:  # noqa: ARG002 -- independent of the pose
        """Compare the clock with the end of the wait."""
        left_ns = self._until_ns - self.node.now_ns
        feedback = _WaitFeedback(duration_message(max(0, left_ns)))
        return BehaviorStep(
            BehaviorStatus.RUNNING if left_ns > 0 else BehaviorStatus.SUCCEEDED, feedback=feedback
        )

    def drive(self, linear: float, angular: float) -> None:
        """Send nothing."""


class BehaviorServer(LifecycleNode):
    """Serves three behaviours, and offers the other two.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    transforms
        What its transform listener fills.
    """

    def __init__(self, domain: Domain, transforms: TransformBuffer, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/behavior_server", latency_ns=latency_ns)
        self._surroundings = Surroundings(transforms)

    def on_configure(self) -> None:
        """Open the topics and the actions."""
        self.create_subscription(
            "nav2_msgs/msg/Costmap",
            "/local_costmap/costmap_raw",
            self._surroundings.on_costmap,
            qos.LATCHED,
        )
        # Subscribed as in Nav2; the outline never changes, so it is not read from here.
        self.create_subscription(
            "geometry_msgs/msg/PolygonStamped",
            "/local_costmap/published_footprint",
            None,
            qos.SYSTEM,
        )
        self.create_subscription(TWIST, "/cmd_vel_teleop", None, qos.SYSTEM)
        self.create_subscription("std_msgs/msg/Empty", "/preempt_teleop", None, qos.SYSTEM)
        Spin(self, self._surroundings)
        BackUp(self, self._surroundings)
        for name in ("drive_on_heading", "assisted_teleop"):
            self.create_publisher(TWIST, "/cmd_vel", qos.RELIABLE)
            leave_unserved(self, [name])
        Wait(self, self._surroundings)
