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
from numpy.typing import NDArray

from sim.middleware.geometry import Pose2D, quaternion_yaw, wrap_angle
from sim.turtlebot3.clear_space import ClearSpace
from sim.turtlebot3.mjcf import STATIC, STEP_NS, WorldParameters, mjcf, pieces
from sim.turtlebot3.rays import Piece, Rays

_EPISODE_GAP_NS = 1_000_000_000  # a robot that scrapes along a wall touches it again and again

# By geom group; a camera also sees the floor.
_SEEN_BY_CAMERAS = np.array([1, 0, 1, 0, 0, 0], np.uint8)

# A state is time, positions (robot: x, y, z, quaternion w, x, y, z; wheels) and their speeds.
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_POSE, _POSITION, _QUATERNION, _WHEEL_ANGLES = np.s_[1:8], np.s_[1:4], np.s_[4:8], np.s_[8:10]
_VELOCITY, _TURNING, _WHEEL_SPEEDS = np.s_[10:13], 15, np.s_[16:18]
# Sensors: gyro, accelerometer, and per piece of the world how often the robot touches it.
_GYRO, _ACCELEROMETER, _INERTIAL, _TOUCHES = np.s_[:3], np.s_[3:6], np.s_[:6], np.s_[6:]

_SKY_RGB = np.array([0.7, 0.7, 0.7])
_AMBIENT = 0.4  # share of ambient light; the rest comes from the sun
_SUN = np.array([0.5, -0.1, 0.9]) / math.sqrt(1.07)  # its direction, as seen from the floor


class ImuSamples(NamedTuple):
    """Measurements of an ideal inertial unit in ``imu_link``, one for each physics step."""

    stamps_ns: NDArray[np.int64]  # (n,)
    orientations: NDArray[np.float64]  # (n, 4), quaternions w, x, y, z
    angular_velocities: NDArray[np.float64]  # (n, 3) [rad/s]
    linear_accelerations: NDArray[np.float64]  # (n, 3), gravity included [m/s^2]


@dataclass(frozen=True, slots=True)
class View:
    """Measurements of an ideal camera along its rays."""

    distances: NDArray[np.float64]  # (n,) to the nearest surface [m]; inf where there is none
    colours: NDArray[np.uint8]  # (n, 3) red, green, blue


@dataclass(frozen=True, slots=True)
class Touch:
    """The robot began to touch a piece of the world."""

    stamp_ns: int
    piece: str


class World:
    """The world with the robot.

    Only the command to the wheels acts on the robot. So the physics runs in blocks, and ahead of
    the clock if a sensor needs several samples at once. While the robot is clear of all pieces,
    it is simulated without them, which gives the same states in two thirds of the time.

    Parameters
    ----------
    parameters
        Start pose, and parameters drawn for the session.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._model = mujoco.MjModel.from_xml_string(mjcf(parameters))
        self._data = mujoco.MjData(self._model)
        self._alone = mujoco.MjModel.from_xml_string(mjcf(parameters, with_pieces=False))
        self._data_alone = mujoco.MjData(self._alone)
        self._arena = parameters.arena
        self._obstacles = parameters.obstacles
        self._clear = ClearSpace(parameters.arena, parameters.obstacles)
        self._is_clear = False  # whether the robot is known to be clear of all pieces
        start = parameters.start
        self._data.qpos[:7] = (
            start.x, start.y, 0.010, math.cos(start.yaw / 2.0), 0.0, 0.0, math.sin(start.yaw / 2.0)
        )  # fmt: skip
        mujoco.mj_forward(self._model, self._data)
        self._rollout = Rollout(nthread=0)
        self._command = np.zeros(self._model.nu)
        self._now_ns = 0
        self._pose_ns = self._state_ns = -1  # time of the two below
        self._pose, self._numbers = start, list[float]()
        # The steps that are computed already: from ``_first`` on, before ``_unknown_ns``.
        self._first = 0
        self._unknown_ns = STEP_NS
        self._states = np.empty((1, mujoco.mj_stateSize(self._model, _STATE.value)))
        mujoco.mj_getState(self._model, self._data, self._states[0], _STATE)
        self._inertial = self._data.sensordata[np.newaxis, _INERTIAL].copy()
        self._warm_start = self._data.qacc_warmstart[np.newaxis].copy()  # of the solver
        self._pieces = [*pieces(parameters)]
        self._last_touch_ns: dict[str, int] = {}
        self.touches: list[Touch] = []
        self._rays = Rays(self._seen_by_lidars())
        # The last row is the sky: a ray that hits nothing reports geom -1.
        self._colours = np.vstack([self._model.geom_rgba[:, :3], _SKY_RGB])

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

    def command_wheels(self, left: float, right: float) -> None:
        """Set the speeds that the wheel motors hold from now on [rad/s].

        Raises
        ------
        ValueError
            If the physics is ahead of the clock, because a sensor has taken later samples.
        """
        if self._row < len(self._states) - 1:
            raise ValueError(f"at {self._now_ns} ns the physics has gone on with the last command")
        self._command = np.array([left, right])

    @property
    def pose(self) -> Pose2D:
        """Ground truth of ``base_footprint`` in the world."""
        if self._pose_ns != self._now_ns:
            self._pose_ns, self._pose = self._now_ns, self._carried_on(self._state())
        return self._pose

    def _carried_on(self, state: list[float]) -> Pose2D:
        """Return the current pose: that of the last step, extrapolated with its speeds."""
        ahead_s = self._ahead_s
        x, y, _ = state[_POSITION]
        w, qx, qy, qz = state[_QUATERNION]
        vx, vy, _ = state[_VELOCITY]
        yaw = wrap_angle(quaternion_yaw(qx, qy, qz, w) + ahead_s * state[_TURNING])
        return Pose2D(x + ahead_s * vx, y + ahead_s * vy, yaw)

    def clearance(self, places: NDArray[np.float64]) -> float:
        """Return the smallest distance of points of shape (n, 2) from any surface [m]."""
        distances = [
            self._arena.clearance(places),
            *(o.signed_distance(places) for o in self._obstacles),
        ]
        return float(np.min(distances))

    @property
    def twist(self) -> tuple[float, float]:
        """Ground truth of the forward [m/s] and the angular speed [rad/s]."""
        state = self._state()
        vx, vy, _ = state[_VELOCITY]
        yaw = self.pose.yaw
        return vx * math.cos(yaw) + vy * math.sin(yaw), state[_TURNING]

    def wheel_states(self) -> tuple[list[float], list[float]]:
        """Return angles [rad] and speeds [rad/s] of the left and the right wheel."""
        state, ahead_s = self._state(), self._ahead_s
        speeds = state[_WHEEL_SPEEDS]
        return [
            angle + ahead_s * speed
            for angle, speed in zip(state[_WHEEL_ANGLES], speeds, strict=True)
        ], speeds

    def _state(self) -> list[float]:
        """Return the state of the last step, which several sensors share."""
        if self._state_ns != self._now_ns:
            self._state_ns, self._numbers = self._now_ns, self._states[self._row].tolist()
        return self._numbers

    def imu(self, until_ns: int) -> ImuSamples:
        """Return the samples of an inertial unit after now, up to ``until_ns``."""
        if until_ns >= self._unknown_ns:
            self._simulate_until(until_ns)
        steps = np.s_[self._row + 1 : until_ns // STEP_NS - self._first + 1]
        states, measured = self._states[steps], self._inertial[steps]
        first = self._first + steps.start
        return ImuSamples(
            STEP_NS * np.arange(first, first + len(states)),
            states[:, _QUATERNION],
            measured[:, _GYRO],
            measured[:, _ACCELEROMETER],
        )

    def scan(
        self, mount: Pose2D, height: float, bearings: NDArray[np.float64], range_max: float
    ) -> NDArray[np.float64]:
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

    def look(
        self, mount: Pose2D, height: float, directions: NDArray[np.float64], range_max: float
    ) -> View:
        """Measure depth and colour along rays; surfaces are matt (Lambert), without shadows.

        Parameters
        ----------
        mount, height
            The camera's pose in the robot's frame, and its height above the floor [m].
        directions : ndarray of shape (n, 3)
            Of the rays, unit vectors in the camera's frame: x forward, y left, z up.
        range_max
            Range of the camera [m].
        """
        camera = self.pose.compose(mount)
        turned = np.empty_like(directions)
        turned[:, :2] = Pose2D(yaw=camera.yaw).apply(directions[:, :2])
        turned[:, 2] = directions[:, 2]
        origin = np.array([camera.x, camera.y, height])
        normals = np.zeros_like(directions)
        rays = len(directions)
        distances, geoms = np.empty(rays), np.empty(rays, np.int32)
        mujoco.mj_multiRay(
            self._model, self._data, origin, turned.ravel(), _SEEN_BY_CAMERAS, 1, -1, geoms,
            distances, normals.reshape(-1), rays, range_max,
        )  # fmt: skip
        missed = (distances < 0.0) | (distances > range_max)
        distances[missed] = np.inf
        geoms[missed] = -1  # no geom
        light = _AMBIENT + (1.0 - _AMBIENT) * np.maximum(normals @ _SUN, 0.0)
        light[missed] = 1.0
        colours = 255.0 * light[:, None] * self._colours[geoms]
        return View(distances, np.rint(colours).astype(np.uint8))

    def _seen_by_lidars(self) -> Iterator[Piece]:
        """Yield the geoms of the pieces of the world; none of them moves."""
        model, data = self._model, self._data
        for geom in np.flatnonzero(model.geom_group == STATIC).tolist():
            is_box = bool(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX)
            yield Piece(data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom], is_box)

    @property
    def _row(self) -> int:
        """Index of the current step among those computed already."""
        return self._now_ns // STEP_NS - self._first

    @property
    def _ahead_s(self) -> float:
        """Time from the last step to now [s]."""
        return self._now_ns % STEP_NS / 1e9

    def _simulate_until(self, time_ns: int) -> None:
        """Compute the missing steps up to ``time_ns``; drop those before now."""
        steps = (time_ns - self._unknown_ns) // STEP_NS + 1
        states, inertial = self._steps(steps)
        known = min(self._row, len(self._states) - 1)
        self._first += known
        self._unknown_ns += steps * STEP_NS
        self._states = np.concatenate((self._states[known:], states))
        self._inertial = np.concatenate((self._inertial[known:], inertial))

    def _steps(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the next states, and the samples of the inertial unit in them."""
        if self._is_clear or self._clear.holds(self._states[-1:, _POSE]):
            states, measured = self._run(self._alone, self._data_alone, count)
            self._is_clear = self._clear.holds(states[:, _POSE])
            if self._is_clear:
                self._warm_start[0] = self._data_alone.qacc_warmstart
                return states, measured
        states, measured = self._run(self._model, self._data, count)
        self._warm_start[0] = self._data.qacc_warmstart
        self._watch_contacts(self._unknown_ns // STEP_NS, measured[:, _TOUCHES])
        return states, measured[:, _INERTIAL]

    def _run(
        self, model: mujoco.MjModel, data: mujoco.MjData, count: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return states and sensors of the next steps by one of the two models."""
        states = np.empty((1, count, self._states.shape[1]))
        measured = np.empty((1, count, model.nsensordata))
        commands = np.empty((1, count, len(self._command)))
        commands[:] = self._command
        self._rollout.rollout(
            [model], [data], self._states[-1:], commands, skip_checks=True, nstep=count,
            initial_warmstart=self._warm_start, state=states, sensordata=measured,
        )  # fmt: skip
        return states[0], measured[0]

    def _watch_contacts(self, first: int, touching: NDArray[np.float64]) -> None:
        """Record each piece that the robot touches and has not touched for a while."""
        for row, piece in np.argwhere(touching).tolist():
            name, stamp_ns = self._pieces[piece], (first + row) * STEP_NS
            last_ns = self._last_touch_ns.get(name)
            if last_ns is None or stamp_ns - last_ns > _EPISODE_GAP_NS:
                self.touches.append(Touch(stamp_ns, name))
            self._last_touch_ns[name] = stamp_ns
