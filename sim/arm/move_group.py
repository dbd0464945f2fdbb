"""MoveIt's node ``move_group``, as far as a pick needs it: scene, plan, execution.

Paths are straight lines of the joints, over what is in the way. There is no sampling planner.
"""

import functools
import math
from typing import Any

import numpy as np

from sim.arm import messages as ros
from sim.arm.cell import MAX_SPEED, TABLE_M, TABLE_X_M
from sim.arm.controllers import FOLLOW
from sim.arm.trajectories import Timed, along, plan
from sim.arrays import Floats
from sim.middleware import qos
from sim.middleware.action import ActionClient, ActionServer, GoalHandle, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import pose_yaw
from sim.middleware.node import Node
from sim.middleware.stamps import stamp_ns

MOVE, MONITORED = "/move_action", "/monitored_planning_scene"
MAX_ACCELERATION = 5.0  # of every joint [rad/s^2]
SUCCESS, PLANNING_FAILED, CONTROL_FAILED, NO_STATE = 1, -1, -4, -5
_SCENE_NS = 250 * MILLISECOND
_STATE_NS = SECOND  # that it waits for the current state
_TABLE = np.array([[TABLE_X_M, 0.0, -TABLE_M[2]], TABLE_M])
_DISPLAY = "moveit_msgs/msg/DisplayTrajectory"


class MoveGroup(Node):
    """Plans a motion to positions of the joints, and has it executed.

    Parameters
    ----------
    domain, latency_ns
        As for `Node`.

    Attributes
    ----------
    speed : float
        Limits of speed and acceleration that plans keep, relative to the configured.
    """

    def __init__(self, domain: Domain, latency_ns: int) -> None:
        super().__init__(domain, "/move_group", latency_ns=latency_ns)
        self.speed = 1.0
        self._boxes: dict[str, Any] = {}  # collision objects
        self._held: list[Any] = []  # attached ones
        self._joints = ros.make(ros.JOINT_STATE)
        self._waiting: GoalHandle | None = None
        self._scene = self.create_publisher(ros.SCENE, MONITORED, qos.profile(100))
        self._display = self.create_publisher(_DISPLAY, "/display_planned_path", qos.RELIABLE)
        subscribe = functools.partial(self.create_subscription, qos=qos.SYSTEM)
        subscribe(ros.JOINT_STATE, "/joint_states", self._on_joints, qos=qos.SENSOR_DATA)
        subscribe(ros.COLLISION_OBJECT, "/collision_object", self._on_object)
        subscribe(ros.SCENE, "/planning_scene", self._on_scene)
        ActionServer(self, ros.MOVE_TYPE, MOVE, self._on_goal)
        self._follow = ActionClient(self, ros.FOLLOW_TYPE, FOLLOW)
        self.create_timer(_SCENE_NS, self._publish_scene)

    def _on_joints(self, message: Any) -> None:
        self._joints, goal, joints = message, self._waiting, ros.joints_of(message)
        if goal is None or joints is None or stamp_ns(message.header.stamp) < goal.accepted_ns:
            return
        self._waiting = None
        self._plan(goal, joints[:-1])

    def _on_object(self, message: Any) -> None:
        self._boxes[message.id] = message
        if message.operation == message.REMOVE:
            del self._boxes[message.id]

    def _on_scene(self, message: Any) -> None:
        self._held = message.robot_state.attached_collision_objects

    def _publish_scene(self) -> None:
        state = ros.make(
            "moveit_msgs/msg/RobotState", joint_state=self._joints, is_diff=True,
            attached_collision_objects=self._held,
        )  # fmt: skip
        boxes = list(self._boxes.values())
        world = ros.make("moveit_msgs/msg/PlanningSceneWorld", collision_objects=boxes)
        named = {"robot_model_name": "ur5e", "is_diff": True}
        self._scene.publish(ros.make(ros.SCENE, robot_state=state, world=world, **named))

    def _on_goal(self, goal: GoalHandle) -> None:
        """Plan as soon as the state of the joints is known that they have now."""
        self._waiting = goal
        self.call_later(_STATE_NS, self._give_up, goal)

    def _give_up(self, goal: GoalHandle) -> None:
        if self._waiting is goal:
            self._waiting = None
            self._end(goal, NO_STATE, "Failed to fetch current robot state")

    def _plan(self, goal: GoalHandle, start: Floats) -> None:
        """Plan from the current state of the joints, and execute."""
        request = goal.goal.request
        wanted = np.array([each.position for each in request.goal_constraints[0].joint_constraints])
        held = {attached.object.id for attached in self._held}
        known = [each for name, each in self._boxes.items() if each.primitives and name not in held]
        path = plan(start, wanted, np.array([_TABLE, *map(_box, known)]))
        if path is None:
            self._end(goal, PLANNING_FAILED, "Motion planning failed: no path without collision")
            return
        speed = self.speed * request.max_velocity_scaling_factor * MAX_SPEED
        pull = self.speed * request.max_acceleration_scaling_factor * MAX_ACCELERATION
        self._execute(goal, along(path, speed, pull))

    def _execute(self, goal: GoalHandle, planned: Timed) -> None:
        message = planned.message(self.now_ns)
        shown = ros.make("moveit_msgs/msg/RobotTrajectory", joint_trajectory=message)
        self._display.publish(ros.make(_DISPLAY, model_id="ur5e", trajectory=[shown]))
        follow = ros.make(f"{ros.FOLLOW_TYPE}_Goal", trajectory=message)
        self._follow.send_goal(follow, lambda status, _: self._executed(goal, status))

    def _executed(self, goal: GoalHandle, status: GoalStatus) -> None:
        code = SUCCESS if status is GoalStatus.SUCCEEDED else CONTROL_FAILED
        self._end(goal, code, f"Completed trajectory execution with status {status.name}")

    def _end(self, goal: GoalHandle, code: int, text: str) -> None:
        codes = ros.make("moveit_msgs/msg/MoveItErrorCodes", val=code)
        log, end = (self.info, goal.succeed) if code == SUCCESS else (self.error, goal.abort)
        log(text)
        end(ros.make(f"{ros.MOVE_TYPE}_Result", error_code=codes))


def _box(message: Any) -> Floats:
    """Return middle and half of the edges of a box around a collision object [m]."""
    at, turn = message.pose.position, pose_yaw(message.pose)
    x, y, z = message.primitives[0].dimensions / 2.0
    c, s = abs(math.cos(turn)), abs(math.sin(turn))
    return np.array([[at.x, at.y, at.z], [c * x + s * y, s * x + c * y, z]])
