"""The program of the cell: picks the object, and puts it down at one place after another.

It moves over the table with MoveIt, and straight down and up with trajectories of its own, which it
sends to the controller's topic, as simple programs for arms do. A goal has succeeded when the
camera sees the object near its place.
"""

import functools
import math
from collections.abc import Callable, Generator, Sequence
from typing import Any

import numpy as np

from oracle_pipeline.bags.manifest import Pose
from sim.arm import cell
from sim.arm import messages as ros
from sim.arm.controllers import COMMAND, GRIP
from sim.arm.move_group import MOVE
from sim.arm.perception import OBJECT
from sim.arm.trajectories import duration_s, timed
from sim.arrays import Floats
from sim.goal_progress import GoalProgress
from sim.middleware import qos
from sim.middleware.action import ActionClient, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import pose_yaw
from sim.middleware.node import Node

SAFE_Z = 0.22  # of the point between the fingertips [m]
SPEED = ACCELERATION = 0.5  # shares of the limits
LINE_M_S, LINE_M_S2 = 0.25, 1.0
GRIP_N, MOST_N = 20.0, 120.0  # of each finger; of the force at which the program stops
HELD_M = cell.OBJECT_M[0] / 2.0  # a finger that is further closed holds nothing
NEAR_M = 0.03  # of its place
_ARRIVED_RAD, _SETTLE_NS = 0.02, 200 * MILLISECOND  # of a straight line
_SEEN_NS, _NO_MOVE_M = 500 * MILLISECOND, 1e-3  # until the camera has seen the object again

Steps = Generator[None, None, None]


class _FailedError(Exception):
    """A step of a pick and place has failed."""


class PickAndPlace(Node):
    """The program.

    Parameters
    ----------
    domain, latency_ns
        As for `Node`.

    Attributes
    ----------
    results : list of GoalProgress
        Of the goals that were begun.
    is_over : bool
        Whether all have ended.
    """

    def __init__(self, domain: Domain, latency_ns: int) -> None:
        super().__init__(domain, "/pick_and_place", latency_ns=latency_ns)
        self._move_group = ActionClient(self, ros.MOVE_TYPE, MOVE)
        self._gripper = ActionClient(self, ros.GRIP_TYPE, GRIP)
        self._trajectory = self.create_publisher(ros.TRAJECTORY, COMMAND)
        self._scene = self.create_publisher(ros.SCENE, "/planning_scene", qos.RELIABLE)
        subscribe = functools.partial(self.create_subscription, qos=qos.SENSOR_DATA)
        subscribe(ros.JOINT_STATE, "/joint_states", self._on_joints)
        subscribe(ros.POSE, "/object_pose", self._on_pose)
        subscribe(ros.WRENCH, "/force_torque_sensor_broadcaster/wrench", self._on_wrench)
        self.results: list[GoalProgress] = []
        self.is_over = False
        self._joints, self._finger = np.array(cell.HOME), cell.FINGER_M
        self._seen = Pose(0.0, 0.0, 0.0)
        self._trouble = ""

    def run(self, places: Sequence[Pose], on_goal: Callable[[int], None]) -> None:
        """Bring the object to one place after another.

        Parameters
        ----------
        places
            On the table.
        on_goal
            Called with the number of each, from 1, when it begins.
        """
        self._steps = self._all(places, on_goal)
        next(self._steps)

    def _all(self, places: Sequence[Pose], on_goal: Callable[[int], None]) -> Steps:
        for number, place in enumerate(places, 1):
            self.results.append(GoalProgress(self.now_ns))
            on_goal(number)
            try:
                yield from self._pick()
                yield from self._put(place)
                self.results[-1].end(self.now_ns, "succeeded")
            except _FailedError as error:
                self.error(f"Goal {number} failed: {error}")
                self.results[-1].end(self.now_ns, "aborted")
                yield from self._wait()
        self.is_over = True

    def _pick(self) -> Steps:
        yield from self._let_go()
        yield from self._over(self._seen)
        yield from self._line(cell.GRASP_Z)
        yield from self._grip(0.0)
        self._check_grasp("there is nothing between the fingers")
        held = ros.box(OBJECT, ros.pose(0.0, 0.0, cell.GRIP_M), cell.OBJECT_M, self.now_ns)
        attached = "moveit_msgs/msg/AttachedCollisionObject"
        self._attach([ros.make(attached, link_name="tool0", object=held)])
        yield from self._line(SAFE_Z)

    def _put(self, place: Pose) -> Steps:
        yield from self._over(place)
        self._check_grasp("the object is lost")
        yield from self._line(cell.GRASP_Z)
        yield from self._let_go()
        yield from self._wait()
        away_m = math.hypot(self._seen.x - place.x, self._seen.y - place.y)
        if not away_m <= NEAR_M:
            raise _FailedError(f"the object is {away_m:.3f} m away from its place")

    def _let_go(self) -> Steps:
        """Open the gripper, and move up."""
        yield from self._grip(cell.FINGER_M)
        self._attach([])
        yield from self._line(SAFE_Z)

    def _resume(self, trouble: str = "") -> None:
        """Go on after a step, which failed if there is trouble."""
        trouble, self._trouble = trouble or self._trouble, ""
        if trouble:
            self._steps.throw(_FailedError(trouble))
        else:
            next(self._steps, None)

    def _wait(self) -> Steps:
        """Wait until the camera has seen what happened; a large force meanwhile is no trouble."""
        self.call_later(_SEEN_NS, next, self._steps, None)
        yield
        self._trouble = ""

    def _over(self, spot: Pose) -> Steps:
        """Move over a place, with the gripper turned as the object is."""
        yaw = (spot.yaw + math.pi / 2.0) % math.pi - math.pi / 2.0
        joints = _solved(cell.downward(spot.x, spot.y, SAFE_Z, yaw), cell.over(spot.x, spot.y))
        turned = joints[-1] - self._joints[-1]
        joints[-1] -= 2.0 * math.pi * round(turned / (2.0 * math.pi))
        request = ros.make(
            "moveit_msgs/msg/MotionPlanRequest", group_name="ur_manipulator",
            goal_constraints=[ros.joint_constraints(joints)],
            max_velocity_scaling_factor=SPEED, max_acceleration_scaling_factor=ACCELERATION,
        )  # fmt: skip
        goal = ros.make(f"{ros.MOVE_TYPE}_Goal", request=request)
        self._move_group.send_goal(goal, self._on_moved)
        yield

    def _on_moved(self, status: GoalStatus, result: Any) -> None:
        succeeded = status is GoalStatus.SUCCEEDED
        self._resume("" if succeeded else f"move_group ended with {result.error_code.val}")

    def _line(self, z: float) -> Steps:
        """Move straight down or up to a height, from where the joint states say that it is."""
        here, last = cell.frames(self._joints)[-1], self._joints
        far = z + cell.GRIP_M - here[2, 3]
        if abs(far) < _NO_MOVE_M:
            return

        def place(share: float) -> Floats:
            nonlocal last
            target = here.copy()
            target[2, 3] += share * far
            last = _solved(target, last)
            return last

        trajectory = timed(place, duration_s(abs(far), LINE_M_S, LINE_M_S2))
        self._trajectory.publish(trajectory.message(self.now_ns))
        after_ns = round(trajectory.times[-1] * SECOND) + _SETTLE_NS
        self.call_later(after_ns, self._arrived, last)
        yield

    def _arrived(self, wanted: Floats) -> None:
        error = np.abs(self._joints - wanted).max()
        self._resume(f"a line ended {error:.2f} rad away" if error > _ARRIVED_RAD else "")

    def _grip(self, position: float) -> Steps:
        command = ros.make("control_msgs/msg/GripperCommand", position=position, max_effort=GRIP_N)
        goal = ros.make(f"{ros.GRIP_TYPE}_Goal", command=command)
        self._gripper.send_goal(goal, lambda *_: self._resume())
        yield

    def _check_grasp(self, otherwise: str) -> None:
        if self._finger < HELD_M:
            raise _FailedError(otherwise)

    def _attach(self, held: list[Any]) -> None:
        """Tell MoveIt what the gripper holds."""
        known = {"is_diff": True, "attached_collision_objects": held}
        state = ros.make("moveit_msgs/msg/RobotState", **known)
        self._scene.publish(ros.make(ros.SCENE, robot_state=state, is_diff=True))

    def _on_joints(self, message: Any) -> None:
        joints = ros.joints_of(message)
        if joints is not None:
            self._joints, self._finger = joints[:-1], float(joints[-1])

    def _on_pose(self, message: Any) -> None:
        at = message.pose.position
        self._seen = Pose(at.x, at.y, pose_yaw(message.pose))

    def _on_wrench(self, message: Any) -> None:
        force = message.wrench.force
        if force.x**2 + force.y**2 + force.z**2 > MOST_N**2:
            self._trouble = "the force on the tool is too large"


def _solved(target: Floats, seed: Floats) -> Floats:
    joints = cell.solve(target, seed)
    if joints is None:
        raise _FailedError("a place is out of reach")
    return joints
