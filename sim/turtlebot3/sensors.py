"""Gazebo's sensor plugins, as nodes: the IMU, the LiDARs and the infrared sensor.

A sensor gets one exact measurement of the world, adds its noise, and publishes the result with the
rate, frame and QoS of the Humble simulation.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.turtlebot3 import frames
from sim.turtlebot3.mjcf import STEP_NS
from sim.turtlebot3.world import ImuSamples

_Imu = message_class("sensor_msgs/msg/Imu")
_LaserScan = message_class("sensor_msgs/msg/LaserScan")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Range = message_class("sensor_msgs/msg/Range")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_IMU = "sensor_msgs/msg/Imu"
_LASER_SCAN = "sensor_msgs/msg/LaserScan"
_RANGE = "sensor_msgs/msg/Range"

View = Callable[[Floats, float], Floats]  # of bearings and a range: distances

IMU_NS = 34 * MILLISECOND  # period of odometry; all samples of one period are measured together
_MOST_SAMPLES = math.ceil(IMU_NS / STEP_NS)  # in one period
SCAN_NS = 200 * MILLISECOND

SCAN_RAYS = 360
SCAN_ANGLE_MAX = 6.28  # [rad]
SCAN_RANGE_MIN_M, SCAN_RANGE_MAX_M = 0.12, 20.0

INFRARED = 1  # sensor_msgs/msg/Range.radiation_type
INFRARED_VIEW = 0.2  # [rad]
INFRARED_MIN_M, INFRARED_MAX_M = 0.05, 2.0
_INFRARED_RAYS = 9

GYRO_NOISE = 2e-4  # standard deviation [rad/s]
ACCELEROMETER_NOISE = 1.7e-2  # standard deviation [m/s^2]


@dataclass(frozen=True, slots=True)
class LidarNoise:
    """Errors of a LiDAR."""

    sd_m: float = 0.01  # standard deviation of each range
    bias_m: float = 0.0  # of all ranges
    dropouts: float = 0.0  # share of the rays without a return


@dataclass(frozen=True, slots=True)
class GyroError:
    """Errors of a gyroscope besides its noise."""

    bias_rad_s: float = 0.0  # about the vertical axis
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Errors of the robot's sensors."""

    scan: LidarNoise = LidarNoise()
    scan_tom: LidarNoise = LidarNoise()
    gyro: GyroError = GyroError()


class ImuPlugin(Node):
    """``/imu``: orientation, angular velocity and acceleration, with noise on the last two.

    The samples of an odometry period are measured together at its start, because the commands to
    the wheels do not change within it.

    Parameters
    ----------
    domain, rng
        As for `Node`.
    measure
        Returns the measurements of an ideal IMU after now and up to a time [ns].
    gyro
        Errors of its gyroscope.
    """

    def __init__(
        self,
        domain: Domain,
        measure: Callable[[int], ImuSamples],
        gyro: GyroError,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(domain, "/turtlebot3_imu", rng=rng)
        self._measure = measure
        self._gyro = gyro
        self._rows = _imu_template().rows(_MOST_SAMPLES)
        self._publisher = self.create_publisher(_IMU, "/imu", qos.profile(5))
        self.create_timer(IMU_NS, self._publish, phase_ns=0)

    def _publish(self) -> None:
        samples = self._measure(self.now_ns + IMU_NS)
        noise = self.rng.standard_normal((len(samples.stamps_ns), 6))
        rows = self._rows[: len(samples.stamps_ns)]
        _fill_in(
            rows, samples.stamps_ns.start, samples.stamps_ns.step, samples.orientations,
            samples.angular_velocities, samples.linear_accelerations, self._gyro.scale,
            self._gyro.bias_rad_s, noise,
        )  # fmt: skip
        data, size = rows.tobytes(), rows.itemsize
        call_at, publish = self.domain.executor.call_at, self._publisher.publish_serialized
        for i, due_ns in enumerate(samples.stamps_ns):
            call_at(due_ns, publish, data[i * size : (i + 1) * size])


def _imu_template() -> Template:
    """Return the template of the messages; stamp, orientation and both measurements differ."""
    prototype = _Imu(
        header(0, "imu_link"),
        _Quaternion(0.0, 0.0, 0.0, 1.0),
        np.zeros(9),  # of the orientation: unknown
        _Vector3(0.0, 0.0, 0.0),
        np.diag([GYRO_NOISE**2] * 3).ravel(),
        _Vector3(0.0, 0.0, 0.0),
        np.diag([ACCELEROMETER_NOISE**2] * 3).ravel(),
    )
    fields = (*STAMP, "orientation", "angular_velocity", "linear_acceleration")
    return Template(prototype, _IMU, fields)


@jit
def _fill_in(
    rows: NDArray[np.void],
    begin_ns: int,
    period_ns: int,
    orientations: Floats,
    angular_velocities: Floats,
    linear_accelerations: Floats,
    scale: float,
    bias: float,
    noise: Floats,
) -> None:
    """Write one message in each row; noise is (n, 6), of both measurements [sd]."""
    for i in range(len(rows)):
        row, stamp_ns = rows[i], begin_ns + i * period_ns
        row["header.stamp.sec"], row["header.stamp.nanosec"] = stamp_ns // SECOND, stamp_ns % SECOND
        for axis in range(3):
            row["orientation"][axis] = orientations[i, 1 + axis]
            turning = scale * angular_velocities[i, axis] + (bias if axis == 2 else 0.0)
            row["angular_velocity"][axis] = turning + GYRO_NOISE * noise[i, axis]
            row["linear_acceleration"][axis] = (
                linear_accelerations[i, axis] + ACCELEROMETER_NOISE * noise[i, 3 + axis]
            )
        row["orientation"][3] = orientations[i, 0]


class LaserPlugin(Node):
    """A planar LiDAR of 360 rays (REP 117: inf no return, -inf too near).

    Parameters
    ----------
    domain, name, topic, mount
        The node, its topic, and the frame of the scans.
    measure
        Returns exact ranges along bearings [rad] in the sensor's frame, up to a distance [m].
    noise, rng
        Its errors, and their generator.
    phase_ns
        Time of the measurement within its period.
    """

    def __init__(
        self,
        domain: Domain,
        name: str,
        topic: str,
        mount: frames.Mount,
        measure: View,
        noise: LidarNoise,
        rng: np.random.Generator,
        phase_ns: int,
    ) -> None:
        super().__init__(domain, name, rng=rng)
        self._frame = mount.child
        self._measure = measure
        self._noise = noise
        self._publisher = self.create_publisher(_LASER_SCAN, topic, qos.profile(5))
        self._bearings = np.linspace(0.0, SCAN_ANGLE_MAX, SCAN_RAYS)
        self._intensities = np.zeros(SCAN_RAYS, np.float32)
        prototype = self._scan(0, np.zeros(SCAN_RAYS, np.float32))
        self._template = Template(prototype, _LASER_SCAN, (*STAMP, "ranges"))
        self.create_timer(SCAN_NS, self._publish, phase_ns=phase_ns)

    def _publish(self) -> None:
        exact = self._measure(self._bearings, SCAN_RANGE_MAX_M)
        ranges = noisy_ranges(exact, self._noise, self.rng)
        data = self._template.data(*self.stamp, ranges)
        self._publisher.publish(self._scan(self.now_ns, ranges), data)

    def _scan(self, time_ns: int, ranges: NDArray[np.float32]) -> object:
        return _LaserScan(
            header(time_ns, self._frame),
            0.0, SCAN_ANGLE_MAX, SCAN_ANGLE_MAX / (SCAN_RAYS - 1), 0.0, 0.0,
            SCAN_RANGE_MIN_M, SCAN_RANGE_MAX_M, ranges, self._intensities,
        )  # fmt: skip


def noisy_ranges(exact: Floats, noise: LidarNoise, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the reported ranges for exact ones [m]; each ray takes two draws in any case."""
    errors, losses = rng.standard_normal(len(exact)), rng.random(len(exact))
    return _measured(exact, noise.bias_m, noise.sd_m, errors, losses, noise.dropouts)


@jit
def _measured(
    exact: Floats, bias: float, sd: float, errors: Floats, losses: Floats, dropouts: float
) -> NDArray[np.float32]:
    ranges = np.empty(len(exact), np.float32)
    for i in range(len(exact)):
        measured = exact[i] + bias + sd * errors[i]
        if measured > SCAN_RANGE_MAX_M or losses[i] < dropouts:
            measured = np.inf
        elif measured < SCAN_RANGE_MIN_M:
            measured = -np.inf
        ranges[i] = measured
    return ranges


class RangePlugin(Node):
    """``/range_ella``: the nearest obstacle in a narrow infrared cone ahead."""

    def __init__(
        self, domain: Domain, measure: View, rng: np.random.Generator, phase_ns: int
    ) -> None:
        super().__init__(domain, "/turtlebot3_range_ella", rng=rng)
        self._measure = measure
        self._bearings = np.linspace(-INFRARED_VIEW / 2, INFRARED_VIEW / 2, _INFRARED_RAYS)
        self._publisher = self.create_publisher(_RANGE, "/range_ella", qos.profile(5))
        self._template = Template(_range_message(0, 0.0), _RANGE, (*STAMP, "range"))
        self.create_timer(SCAN_NS, self._publish, phase_ns=phase_ns)

    def _publish(self) -> None:
        nearest = float(self._measure(self._bearings, INFRARED_MAX_M).min())
        measured = nearest + LidarNoise().sd_m * self.rng.standard_normal()
        if measured > INFRARED_MAX_M:
            measured = math.inf
        elif measured < INFRARED_MIN_M:
            measured = -math.inf
        data = self._template.data(*self.stamp, measured)
        self._publisher.publish(_range_message(self.now_ns, measured), data)


def _range_message(time_ns: int, measured: float) -> object:
    return _Range(
        header(time_ns, frames.RANGE_ELLA.child), INFRARED, INFRARED_VIEW, INFRARED_MIN_M,
        INFRARED_MAX_M, measured,
    )  # fmt: skip
