"""The physics: the world's pieces and the Waffle in MuJoCo, and what its sensors would measure.

Nothing else touches ``MjModel`` and ``MjData``. Measurements here are exact; noise, messages and
rates belong to the sensors' nodes. Frames: the world's, and the robot's ``base_footprint``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.middleware.geometry import Pose2D, quaternion_yaw, wrap_angle
from sim.turtlebot3.arena import BLOCKS, CYLINDERS, RING, RING_THICKNESS, Cylinder, Hexagon

STEP_NS = 5_000_000

WHEEL_RADIUS_M = 0.033
WHEEL_SEPARATION_M = 0.287  # the diff drive's figure; the model's geometry says 0.288
MAX_WHEEL_TORQUE_NM = 20.0
# A stiffer motor would reach its set-point within one step, and kick the robot off the floor.
_MOTOR_GAIN = 0.2  # [N m s/rad]

_EPISODE_GAP_NS = 1_000_000_000  # a robot that grinds along a wall bounces off and on

_STATIC, _ROBOT, _FLOOR = 0, 1, 2  # geom groups: rays see the first only
# A wheel stands on the floor at one point, as a sphere does: two edges of a cylinder would scrub
# against each other in every turn. The cylinder is what meets the pieces of the world.
_TREAD_BIT = 2
_SEEN_BY_RAYS = np.array([1, 0, 0, 0, 0, 0], np.uint8)


@dataclass(frozen=True, slots=True)
class WorldParameters:
    """What differs from run to run."""

    start: Pose2D  # of base_footprint in the world
    friction: float = 1.0  # of the floor, relative to the model
    mass: float = 1.0  # of the robot, relative to the model
    obstacles: Sequence[Cylinder] = ()  # real ones that are on no map


@dataclass(frozen=True, slots=True)
class ImuSample:
    """What an ideal inertial unit in ``imu_link`` measures."""

    orientation: tuple[float, float, float, float]  # quaternion x, y, z, w
    angular_velocity: NDArray[np.float64]  # (3,) [rad/s]
    linear_acceleration: NDArray[np.float64]  # (3,), gravity included [m/s^2]


@dataclass(frozen=True, slots=True)
class Touch:
    """The robot began to touch a piece of the world."""

    stamp_ns: int
    piece: str


class World:
    """The world and the robot in it.

    Parameters
    ----------
    parameters
        Start pose and what the session draws.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._model = mujoco.MjModel.from_xml_string(_mjcf(parameters))
        self._data = mujoco.MjData(self._model)
        start = parameters.start
        self._data.qpos[:7] = (
            start.x, start.y, 0.010, math.cos(start.yaw / 2.0), 0.0, 0.0, math.sin(start.yaw / 2.0)
        )  # fmt: skip
        mujoco.mj_forward(self._model, self._data)
        self._steps = 0
        self._ahead_s = 0.0  # of the last step, until the next one is due
        self._last_touch_ns: dict[str, int] = {}
        self.touches: list[Touch] = []
        groups = self._model.geom_group
        self._piece_of_geom = {
            geom: self._model.geom(geom).name.partition("#")[0]
            for geom in np.flatnonzero(groups == _STATIC).tolist()
        }
        joints = [self._model.joint(name) for name in ("wheel_left", "wheel_right")]
        self._wheel_angles = [int(joint.qposadr[0]) for joint in joints]
        self._wheel_speeds = [int(joint.dofadr[0]) for joint in joints]

    @property
    def time_ns(self) -> int:
        """Time of the physics; a multiple of the step [ns]."""
        return self._steps * STEP_NS

    def advance_to(self, time_ns: int) -> None:
        """Take every step that is due by ``time_ns``, and note new contacts after each.

        Poses and wheel angles are carried on to ``time_ns`` itself with their speeds: Gazebo
        steps five times as often, and odometry that jumps by a step would look like slip.
        """
        for _ in range(time_ns // STEP_NS - self._steps):
            mujoco.mj_step(self._model, self._data)
            self._steps += 1
            self._watch_contacts()
        self._ahead_s = (time_ns - self.time_ns) / 1e9

    def command_wheels(self, left: float, right: float) -> None:
        """Set what the wheel motors hold from now on [rad/s]."""
        self._data.ctrl[0] = left
        self._data.ctrl[1] = right

    @property
    def pose(self) -> Pose2D:
        """Ground truth of ``base_footprint`` in the world."""
        x, y, _, w, qx, qy, qz = self._data.qpos[:7].tolist()
        vx, vy, _, _, _, turning = self._data.qvel[:6].tolist()
        yaw = wrap_angle(quaternion_yaw(qx, qy, qz, w) + self._ahead_s * turning)
        return Pose2D(x + self._ahead_s * vx, y + self._ahead_s * vy, yaw)

    @property
    def twist(self) -> tuple[float, float]:
        """Ground truth of the forward [m/s] and the turning speed [rad/s]."""
        vx, vy, _, _, _, turning = self._data.qvel[:6].tolist()
        yaw = self.pose.yaw
        return vx * math.cos(yaw) + vy * math.sin(yaw), turning

    def wheel_states(self) -> tuple[list[float], list[float]]:
        """Return angles [rad] and speeds [rad/s] of the left and the right wheel."""
        speeds = [float(self._data.qvel[i]) for i in self._wheel_speeds]
        angles = [
            float(self._data.qpos[i]) + self._ahead_s * speed
            for i, speed in zip(self._wheel_angles, speeds, strict=True)
        ]
        return angles, speeds

    def imu(self) -> ImuSample:
        """Return what an ideal inertial unit in ``imu_link`` measures."""
        w, x, y, z = self._data.qpos[3:7].tolist()
        measured = self._data.sensordata
        return ImuSample((x, y, z, w), measured[0:3].copy(), measured[3:6].copy())

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
            How far the sensor sees [m].

        Returns
        -------
        ndarray of shape (n,)
            Distance to the nearest surface that is not the robot's own [m]; ``inf`` beyond
            ``range_max``.
        """
        sensor = self.pose.compose(mount)
        directions = np.zeros((len(bearings), 3))
        directions[:, 0] = np.cos(bearings + sensor.yaw)
        directions[:, 1] = np.sin(bearings + sensor.yaw)
        distances = np.empty(len(bearings))
        geoms = np.empty(len(bearings), np.int32)
        origin = np.array([sensor.x, sensor.y, height])
        mujoco.mj_multiRay(
            self._model, self._data, origin, directions.ravel(), _SEEN_BY_RAYS, 1, -1,
            geoms, distances, None, len(bearings), range_max,
        )  # fmt: skip
        distances[(distances < 0.0) | (distances > range_max)] = np.inf
        return distances

    def _watch_contacts(self) -> None:
        """Note each piece that the robot touches and had not touched for a while."""
        for geom in self._data.contact.geom.ravel().tolist():
            piece = self._piece_of_geom.get(geom)
            if piece is None:
                continue
            last_ns = self._last_touch_ns.get(piece)
            if last_ns is None or self.time_ns - last_ns > _EPISODE_GAP_NS:
                self.touches.append(Touch(self.time_ns, piece))
            self._last_touch_ns[piece] = self.time_ns


def _mjcf(parameters: WorldParameters) -> str:
    """Return the model; masses and sizes are those of Nav2's Humble ``waffle.model``."""
    pieces = "".join(
        [*map(_block, BLOCKS), _ring()]
        + [_cylinder(c) for c in (*CYLINDERS, *parameters.obstacles)]
    )
    return f"""
<mujoco>
  <option timestep="{STEP_NS / 1e9}" gravity="0 0 -9.8" integrator="implicitfast"/>
  <default>
    <geom friction="{parameters.friction} 0.005 0.0001"/>
    <default class="robot"><geom group="{_ROBOT}"/></default>
    <default class="on_floor">
      <geom group="{_ROBOT}" contype="{_TREAD_BIT}" conaffinity="{_TREAD_BIT}"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 1" group="{_FLOOR}"
          contype="{_TREAD_BIT}" conaffinity="{_TREAD_BIT}"/>
    {pieces}
    <body name="base_footprint">
      <freejoint/>
      <geom class="robot" type="box" size="0.1325 0.1325 0.0445" pos="-0.064 0 0.048"
            mass="{1.0 * parameters.mass}"/>
      <geom class="robot" type="cylinder" size="0.0508 0.0275" pos="-0.052 0 0.111"
            mass="{0.125 * parameters.mass}"/>
      <geom class="on_floor" type="sphere" size="0.005" pos="-0.177 0.064 -0.004" mass="0.001"
            condim="1" priority="1"/>
      <geom class="on_floor" type="sphere" size="0.005" pos="-0.177 -0.064 -0.004" mass="0.001"
            condim="1" priority="1"/>
      <site name="imu_link" pos="0 0 0.068"/>
      {_wheel("wheel_left", 0.144)}
      {_wheel("wheel_right", -0.144)}
    </body>
  </worldbody>
  <actuator>
    {_motor("wheel_left")}
    {_motor("wheel_right")}
  </actuator>
  <sensor><gyro site="imu_link"/><accelerometer site="imu_link"/></sensor>
</mujoco>"""


def _wheel(name: str, y: float) -> str:
    return f"""
      <body name="{name}" pos="0 {y} 0.023">
        <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
        <joint name="{name}" axis="0 1 0"/>
        <geom class="robot" type="cylinder" size="{WHEEL_RADIUS_M} 0.009" euler="90 0 0"/>
        <geom class="on_floor" type="sphere" size="{WHEEL_RADIUS_M}" mass="0"/>
      </body>"""


def _motor(joint: str) -> str:
    limit = MAX_WHEEL_TORQUE_NM
    return f'<velocity joint="{joint}" kv="{_MOTOR_GAIN}" forcerange="-{limit} {limit}"/>'


def _block(hexagon: Hexagon) -> str:
    """Return a hexagon: the union of the three boxes that join its opposite sides."""
    half = (hexagon.apothem, hexagon.circumradius / 2.0, (hexagon.z_max - hexagon.z_min) / 2.0)
    return "".join(
        _box(
            f"{hexagon.name}#{i}", hexagon.x, hexagon.y, hexagon.z_min + half[2], half, 30 + 60 * i
        )
        for i in range(3)
    )


def _ring() -> str:
    """Return six walls, long enough to close the corners behind the inner faces."""
    height = (RING.z_max - RING.z_min) / 2.0
    half = (RING_THICKNESS / 2.0, RING.circumradius * 9.0 / 16.0, height)
    distance = RING.apothem + half[0]
    walls = []
    for i in range(6):
        degrees = 30 + 60 * i
        x, y = (distance * f(math.radians(degrees)) for f in (math.cos, math.sin))
        walls.append(_box(f"{RING.name}#{i}", x, y, RING.z_min + height, half, degrees))
    return "".join(walls)


def _box(
    name: str, x: float, y: float, z: float, half: tuple[float, float, float], degrees: float
) -> str:
    size = " ".join(map(str, half))
    return (
        f'<geom name="{name}" type="box" pos="{x} {y} {z}" size="{size}" '
        f'euler="0 0 {degrees}" group="{_STATIC}"/>'
    )


def _cylinder(c: Cylinder) -> str:
    half = c.height / 2.0
    return (
        f'<geom name="{c.name}" type="cylinder" pos="{c.x} {c.y} {half}" '
        f'size="{c.radius} {half}" group="{_STATIC}"/>'
    )
