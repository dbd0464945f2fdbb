"""The physics: the world and the Waffle in MuJoCo, and exact measurements of its sensors.

No other module uses ``MjModel`` or ``MjData``. Noise, messages and rates belong to the nodes of the
sensors. Frames: the world's, and the robot's ``base_footprint``.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats
from sim.middleware.geometry import Pose2D, quaternion_yaw, wrapped
from sim.turtlebot3.clear_space import ClearSpace
from sim.turtlebot3.mjcf import AROUND, STEP_NS, WorldParameters, mjcf, pieces
from sim.turtlebot3.pedestrian import Pedestrian
from sim.turtlebot3.rays import Geom, Rays
from sim.turtlebot3.wheel_odometry import Wheels

_EPISODE_GAP_NS = 1_000_000_000  # a robot that scrapes along a wall touches it again and again

# A state is time, positions (robot: x, y, z, quaternion w, x, y, z; wheels) and their speeds.
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_POSE, _QUATERNION = np.s_[1:8], np.s_[4:8]
# An input is the speeds of the motors, and the place of a person.
_INPUT = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_MOCAP_POS.value
# Sensors: gyro, accelerometer, and per piece of the world how often the robot touches it.
_GYRO, _ACCELEROMETER, _INERTIAL, _TOUCHES = np.s_[:3], np.s_[3:6], np.s_[:6], np.s_[6:]


class ImuSamples(NamedTuple):
    """Measurements of an ideal inertial unit in ``imu_link``, one for each physics step."""

    stamps_ns: range  # n of them
    orientations: Floats  # (n, 4), quaternions w, x, y, z
    angular_velocities: Floats  # (n, 3) [rad/s]
    linear_accelerations: Floats  # (n, 3), gravity included [m/s^2]


class _Motion(NamedTuple):
    """What odometry and joint states measure at a time."""

    pose: Pose2D
    twist: tuple[float, float]  # forward [m/s], turning [rad/s]
    wheel_angles: Wheels  # [rad]
    wheel_speeds: Wheels  # [rad/s]


class _Physics(NamedTuple):
    """A compiled model and its state, each in a list as `Rollout` takes them."""

    models: list[mujoco.MjModel]
    datas: list[mujoco.MjData]
    warm_start: Floats  # of its solver; a view of the state
    inputs: int  # numbers of an input

    @classmethod
    def of(cls, description: str) -> "_Physics":
        model = mujoco.MjModel.from_xml_string(description)
        data = mujoco.MjData(model)
        return cls([model], [data], data.qacc_warmstart, mujoco.mj_stateSize(model, _INPUT))


@dataclass(frozen=True, slots=True)
class _Touch:
    """The robot began to touch a piece of the world."""

    stamp_ns: int
    piece: str


class World:
    """The world with the robot.

    Only the command to the wheels, and a person, act on the robot. So the physics runs in blocks,
    and ahead of the clock if a sensor needs several samples at once; a person stands still within
    a block. While the robot is clear of all pieces, it is simulated without them, which gives the
    same states in two thirds of the time.

    Parameters
    ----------
    parameters
        Start pose, and parameters drawn for the session.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._whole = _Physics.of(mjcf(parameters))
        self._alone = _Physics.of(mjcf(parameters, with_pieces=False))
        (self._model,), (self._data,) = self._whole.models, self._whole.datas
        self._arena = parameters.arena
        self._obstacles = parameters.obstacles
        self._pedestrian = Pedestrian(parameters.walk) if parameters.walk else None
        self._clear = ClearSpace(parameters.arena, parameters.unmapped)
        self._is_clear = False  # whether the robot is known to be clear of all pieces
        start = parameters.start
        self._data.qpos[:7] = (
            start.x, start.y, 0.010, math.cos(start.yaw / 2.0), 0.0, 0.0, math.sin(start.yaw / 2.0)
        )  # fmt: skip
        mujoco.mj_forward(self._model, self._data)
        self._rollout = Rollout(nthread=0)
        self._input = np.zeros(self._whole.inputs)
        self._now_ns = 0
        self._motion_ns = -1  # of the motion below
        self._motion = _Motion(start, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
        # The steps that are computed already: from ``_first`` on, before ``_unknown_ns``.
        self._first = 0
        self._unknown_ns = STEP_NS
        self._states = np.empty((1, mujoco.mj_stateSize(self._model, _STATE.value)))
        mujoco.mj_getState(self._model, self._data, self._states[0], _STATE)
        self._inertial = self._data.sensordata[np.newaxis, _INERTIAL].copy()
        self._warm_start = self._data.qacc_warmstart[np.newaxis].copy()  # of the solver
        self._pieces = [*pieces(parameters)]
        self._last_touch_ns: dict[str, int] = {}
        self.touches: list[_Touch] = []
        self._rays = Rays(self._seen_by_lidars())
        if self._pedestrian:
            self._walk(self._pedestrian, 0)

    @property
    def time_ns(self) -> int:
        """Time of the last physics step; a multiple of its length [ns]."""
        return self._now_ns // STEP_NS * STEP_NS

    def advance_to(self, time_ns: int) -> None:
        """Take every step that is due by ``time_ns``, and record new contacts after each.

        Poses and wheel angles are extrapolated to ``time_ns`` with their speeds. Gazebo has five
        times as many steps, and odometry that is late by up to a step would look like slip.
        """
        self._now_ns = time_ns
        if time_ns >= self._unknown_ns:
            self._simulate_until(time_ns)
        if self._pedestrian:
            self._walk(self._pedestrian, time_ns)

    def command_wheels(self, left: float, right: float) -> None:
        """Set the speeds that the wheel motors hold from now on [rad/s].

        Raises
        ------
        ValueError
            If the physics is ahead of the clock, because a sensor has taken later samples.
        """
        if self._row < len(self._states) - 1:
            raise ValueError(f"at {self._now_ns} ns the physics has gone on with the last command")
        self._input[0], self._input[1] = left, right

    @property
    def pose(self) -> Pose2D:
        """Ground truth of ``base_footprint`` in the world."""
        return self._moving().pose

    def clearance(self, places: Floats) -> float:
        """Return the smallest distance of points of shape (n, 2) from any surface [m]."""
        distances = [
            self._arena.clearance(places),
            *(o.signed_distance(places) for o in self._obstacles),
        ]
        return float(np.min(distances))

    @property
    def twist(self) -> tuple[float, float]:
        """Ground truth of the forward [m/s] and the angular speed [rad/s]."""
        return self._moving().twist

    def wheel_states(self) -> tuple[Wheels, Wheels]:
        """Return angles [rad] and speeds [rad/s] of the left and the right wheel."""
        motion = self._moving()
        return motion.wheel_angles, motion.wheel_speeds

    def _moving(self) -> _Motion:
        """Return the motion as of now, which several sensors share."""
        if self._motion_ns != self._now_ns:
            x, y, yaw, *rest = _carried_on(self._states[self._row], self._now_ns)
            self._motion_ns = self._now_ns
            self._motion = _Motion(Pose2D(x, y, yaw), *rest)
        return self._motion

    def imu(self, until_ns: int) -> ImuSamples:
        """Return the samples of an inertial unit after now, up to ``until_ns``."""
        if until_ns >= self._unknown_ns:
            self._simulate_until(until_ns)
        begin, end = self._row + 1, until_ns // STEP_NS - self._first + 1
        states, measured = self._states[begin:end], self._inertial[begin:end]
        begin_ns = (self._first + begin) * STEP_NS
        return ImuSamples(
            range(begin_ns, begin_ns + len(states) * STEP_NS, STEP_NS),
            states[:, _QUATERNION],
            measured[:, _GYRO],
            measured[:, _ACCELEROMETER],
        )

    def scan(self, mount: Pose2D, height: float, bearings: Floats, range_max: float) -> Floats:
        """Measure along horizontal rays.

        Parameters
        ----------
        mount, height
            The sensor's pose in the robot's frame, and its height above the floor [m].
        bearings : ndarray of shape (n,)
            Of the rays in the sensor's frame [rad].
        range_max
            Range of the sensor [m].

        Returns
        -------
        ndarray of shape (n,)
            Distance to the nearest surface that is not the robot's own [m]; ``inf`` beyond
            ``range_max``.
        """
        sensor = self.pose.compose(mount)
        angles = bearings + sensor.yaw
        origin = (sensor.x, sensor.y, height)
        return self._rays.distances(origin, np.cos(angles), np.sin(angles), range_max)

    def _walk(self, pedestrian: Pedestrian, time_ns: int) -> None:
        """Let the person walk on, for the sensors and for the physics."""
        pedestrian.walk_until(time_ns, self.pose)
        place = pedestrian.position
        self._rays.move_last(*place)
        self._clear.move_last(*place)
        self._input[self._model.nu :][:2] = place
        self._is_clear = False

    def _seen_by_lidars(self) -> Iterator[Geom]:
        """Yield the geoms of the pieces of the world."""
        model, data = self._model, self._data
        for geom in np.flatnonzero(model.geom_group == AROUND).tolist():
            is_box = bool(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX)
            yield Geom(data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom], is_box)

    @property
    def _row(self) -> int:
        """Index of the current step among those computed already."""
        return self._now_ns // STEP_NS - self._first

    def _simulate_until(self, time_ns: int) -> None:
        """Compute the missing steps up to ``time_ns``; drop those before now."""
        before = min(self._row, len(self._states) - 1)
        known = len(self._states) - before
        steps = (time_ns - self._unknown_ns) // STEP_NS + 1
        states = np.empty((known + steps, self._states.shape[1]))
        inertial = np.empty((known + steps, self._inertial.shape[1]))
        states[:known], inertial[:known] = self._states[before:], self._inertial[before:]
        self._step(states[known:], inertial[known:])
        self._first += before
        self._unknown_ns += steps * STEP_NS
        self._states, self._inertial = states, inertial

    def _step(self, states: Floats, inertial: Floats) -> None:
        """Fill in the next states, and the samples of the inertial unit in them."""
        if self._is_clear or self._clear.holds(self._states[-1:, _POSE]):
            self._run(self._alone, states, inertial)
            self._is_clear = self._clear.holds(states[:, _POSE])
            if self._is_clear:
                self._warm_start[0] = self._alone.warm_start
                return
        measured = np.empty((len(states), self._model.nsensordata))
        self._run(self._whole, states, measured)
        self._warm_start[0] = self._whole.warm_start
        self._watch_contacts(self._unknown_ns // STEP_NS, measured[:, _TOUCHES])
        inertial[:] = measured[:, _INERTIAL]

    def _run(self, physics: _Physics, states: Floats, measured: Floats) -> None:
        """Fill in states and sensors of the next steps by one of the two models."""
        inputs = np.empty((1, len(states), physics.inputs))
        inputs[:] = self._input[: physics.inputs]
        self._rollout.rollout(
            physics.models, physics.datas, self._states[-1:], inputs, control_spec=_INPUT,
            skip_checks=True, nstep=len(states), initial_warmstart=self._warm_start,
            state=states[np.newaxis], sensordata=measured[np.newaxis],
        )  # fmt: skip

    def _watch_contacts(self, first: int, touching: Floats) -> None:
        """Record each piece that the robot touches and has not touched for a while."""
        for row, piece in np.argwhere(touching).tolist():
            name, stamp_ns = self._pieces[piece], (first + row) * STEP_NS
            last_ns = self._last_touch_ns.get(name)
            if last_ns is None or stamp_ns - last_ns > _EPISODE_GAP_NS:
                self.touches.append(_Touch(stamp_ns, name))
            self._last_touch_ns[name] = stamp_ns


@jit
def _carried_on(
    state: Floats, now_ns: int
) -> tuple[float, float, float, tuple[float, float], Wheels, Wheels]:
    """Return the motion now: that of the last step, extrapolated with its speeds."""
    ahead_s = now_ns % STEP_NS / 1e9
    _, x, y, _, w, qx, qy, qz, left, right, vx, vy, _, _, _, turning, v_left, v_right = state
    yaw = wrapped(_yaw(qx, qy, qz, w) + ahead_s * turning)
    return (
        x + ahead_s * vx,
        y + ahead_s * vy,
        yaw,
        (vx * math.cos(yaw) + vy * math.sin(yaw), turning),
        (left + ahead_s * v_left, right + ahead_s * v_right),
        (v_left, v_right),
    )


_yaw = jit(quaternion_yaw)
