"""ros2_control: the controller manager, its controllers and broadcasters.

They read and command the joints through the hardware interface, 100 times a second.
"""

from typing import Any, Protocol

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from oracle_pipeline.bags.template import STAMP, Template
from sim.arm.cell import FINGER, HOME, JOINTS
from sim.arm.messages import FOLLOW_TYPE, GRIP_TYPE, JOINT_STATE, TRAJECTORY, WRENCH, make
from sim.arm.trajectories import from_message
from sim.arrays import Floats
from sim.middleware import qos
from sim.middleware.action import ActionServer, GoalHandle
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header

UPDATE_NS, STATE_NS = 10 * MILLISECOND, 20 * MILLISECOND
CONTROLLER = "/joint_trajectory_controller"
COMMAND, FOLLOW = f"{CONTROLLER}/joint_trajectory", f"{CONTROLLER}/follow_joint_trajectory"
GRIP = "/gripper_controller/gripper_cmd"
# Tolerances of the driver of Universal Robots; what the joints may take longer to the end.
_PATH_RAD, _GOAL_RAD, _GOAL_S = 0.2, 0.1, 1.0
_SUCCESSFUL, _INVALID_GOAL, _PATH_VIOLATED, _GOAL_VIOLATED = 0, -1, -4, -5  # error codes
_GRIP_M, _STALL_M_S, _STALL_NS = 0.001, 0.005, 200 * MILLISECOND
_STATE = "control_msgs/msg/JointTrajectoryControllerState"
_POINT, _CLOCK = "trajectory_msgs/msg/JointTrajectoryPoint", "rosgraph_msgs/msg/Clock"


class Hardware(Protocol):
    """What controllers see of the robot."""

    def measure(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return positions, velocities and efforts of joints and finger, and the wrench."""

    def command(self, positions: Floats, speeds: Floats) -> None:
        """Give the joints a setpoint."""

    def grip(self, position: float, effort: float) -> None:
        """Give each finger a position [m] and a limit of its force [N]."""


class TrajectoryController(Node):
    """The joint trajectory controller: follows trajectories of an action's goals and of a topic."""

    def __init__(self, domain: Domain, hardware: Hardware, latency_ns: int) -> None:
        super().__init__(domain, CONTROLLER, latency_ns=latency_ns)
        self._hardware = hardware
        self._hold(np.array(HOME))
        names = ("state", "desired", "actual"), ("controller_state", "reference", "feedback")
        self._states = [self._state(*each) for each in names]
        self.create_subscription(TRAJECTORY, COMMAND, self._begin, qos.SYSTEM)
        ActionServer(self, FOLLOW_TYPE, FOLLOW, self._on_goal)

    def _state(self, name: str, wanted: str, measured: str) -> tuple[Any, Template]:
        """Return publisher and template of a topic with the controller's state."""
        none = dict.fromkeys(("positions", "velocities"), np.zeros(len(JOINTS)))
        points = {part: make(_POINT, **none) for part in (wanted, measured, "error")}
        message = make(_STATE, joint_names=[*JOINTS], **points)
        fields = (f"{part}.{what}" for part in points for what in none)
        publisher = self.create_publisher(_STATE, f"{CONTROLLER}/{name}", qos.RELIABLE)
        return publisher, Template(message, _STATE, (*STAMP, *fields))

    def _on_goal(self, goal: GoalHandle) -> None:
        self._begin(goal.goal.trajectory, goal)

    def _hold(self, positions: Floats) -> None:
        """Stay at a place."""
        self._goal: GoalHandle | None = None
        self._path: CubicHermiteSpline | None = None
        self._last = positions, np.zeros(len(JOINTS))

    def _begin(self, message: Any, goal: GoalHandle | None = None) -> None:
        """Follow a trajectory from now on."""
        before, self._goal, self._begun_ns = self._goal, goal, self.now_ns
        if before is not None:
            before.abort(_result(_SUCCESSFUL, "Replaced by another trajectory"))
        try:
            self._path = from_message(message)
        except (ValueError, IndexError) as error:
            self._fail(self._last[0], _INVALID_GOAL, f"Invalid trajectory: {error}")

    def _fail(self, positions: Floats, code: int, text: str) -> None:
        self.error(text)
        goal = self._goal
        self._hold(positions)
        self._hardware.command(*self._last)
        if goal is not None:
            goal.abort(_result(code, text))

    def update(self, positions: Floats, speeds: Floats) -> None:
        """Give the joints their next setpoint, from what is measured of them."""
        if self._path is not None:
            self._follow(self._path, positions)
        if self.now_ns % STATE_NS == 0:
            wanted, speed = self._last
            rows = wanted, speed, positions, speeds, wanted - positions, speed - speeds
            for publisher, template in self._states:
                publisher.publish_serialized(template.data(*self.stamp, *rows))

    def _follow(self, path: CubicHermiteSpline, positions: Floats) -> None:
        """Go on along a path; end at its end, or when it is left."""
        time_s, end_s = (self.now_ns - self._begun_ns) / SECOND, path.x[-1]
        at_s = min(time_s, end_s)
        self._last = path(at_s), path(at_s, 1) * (time_s < end_s)
        self._hardware.command(*self._last)
        error, goal = np.abs(self._last[0] - positions).max(), self._goal
        if error > _PATH_RAD:
            self._fail(positions, _PATH_VIOLATED, "Aborted due to path tolerance violation")
        elif time_s >= end_s and error <= _GOAL_RAD:
            self._hold(self._last[0])
            if goal is not None:
                self.info("Goal reached, success!")
                goal.succeed(_result(_SUCCESSFUL, "Goal successfully reached!"))
        elif time_s > end_s + _GOAL_S:
            self._fail(positions, _GOAL_VIOLATED, "Aborted due to goal tolerance violation")


def _result(code: int, text: str) -> Any:
    return make(f"{FOLLOW_TYPE}_Result", error_code=code, error_string=text)


class GripperController(Node):
    """The gripper action controller: succeeds at the position, or when the fingers stall."""

    def __init__(self, domain: Domain, hardware: Hardware, latency_ns: int) -> None:
        super().__init__(domain, "/gripper_controller", latency_ns=latency_ns)
        self._hardware = hardware
        self._goal: GoalHandle | None = None
        ActionServer(self, GRIP_TYPE, GRIP, self._on_goal)

    def _on_goal(self, goal: GoalHandle) -> None:
        self._goal, self._moved_ns = goal, self.now_ns
        self._hardware.grip(goal.goal.command.position, goal.goal.command.max_effort)

    def update(self, position: float, speed: float, effort: float) -> None:
        """Look how far a goal has come, from what is measured of a finger."""
        goal = self._goal
        if goal is None or not goal.is_active:
            return
        if abs(speed) > _STALL_M_S:
            self._moved_ns = self.now_ns
        reached = abs(position - goal.goal.command.position) <= _GRIP_M
        stalled = self.now_ns - self._moved_ns > _STALL_NS
        if reached or stalled:
            ended = {"position": position, "effort": effort, "stalled": stalled}
            goal.succeed(make(f"{GRIP_TYPE}_Result", reached_goal=reached, **ended))


class ControllerManager(Node):
    """The controller manager, with all controllers and broadcasters; also ``/clock``.

    Parameters
    ----------
    domain
        As for `Node`.
    hardware
        The robot.
    latency_ns
        Of the controllers.
    """

    def __init__(self, domain: Domain, hardware: Hardware, latency_ns: int) -> None:
        super().__init__(domain, "/controller_manager")
        self._hardware = hardware
        self._arm = TrajectoryController(domain, hardware, latency_ns)
        self._gripper = GripperController(domain, hardware, latency_ns)
        names = "/joint_state_broadcaster", "/force_torque_sensor_broadcaster"
        joints, wrench = (Node(domain, name) for name in names)
        self._joints = joints.create_publisher(JOINT_STATE, "/joint_states", qos.RELIABLE)
        self._wrench = wrench.create_publisher(WRENCH, f"{wrench.name}/wrench", qos.RELIABLE)
        self._clock = self.create_publisher(_CLOCK, "/clock", qos.CLOCK)
        rows = dict.fromkeys(("position", "velocity", "effort"), np.zeros(len(JOINTS) + 1))
        state = make(JOINT_STATE, name=[*JOINTS, FINGER], **rows)
        self._state = Template(state, JOINT_STATE, (*STAMP, *rows))
        force = make(WRENCH, header=header(0, "tool0"))
        self._force = Template(force, WRENCH, (*STAMP, "wrench"))
        self._time = Template(make(_CLOCK), _CLOCK, ("clock.sec", "clock.nanosec"))
        self.create_timer(UPDATE_NS, self._update, phase_ns=0)

    def _update(self) -> None:
        stamp = self.stamp
        positions, speeds, efforts, wrench = self._hardware.measure()
        self._clock.publish_serialized(self._time.data(*stamp))
        self._joints.publish_serialized(self._state.data(*stamp, positions, speeds, efforts))
        self._wrench.publish_serialized(self._force.data(*stamp, wrench))
        self._arm.update(positions[:-1], speeds[:-1])
        self._gripper.update(*(float(row[-1]) for row in (positions, speeds, efforts)))
