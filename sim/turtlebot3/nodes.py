"""Gazebo's side of the graph: the simulator's plugins and the robot state publisher, as nodes.

A node here sees of the world only the one measurement it is given, adds the sensor's noise and
publishes it with the rate, frame and QoS of the Humble simulation; ``add_robot`` puts all of them
into a domain.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D, yaw_quaternion
from sim.middleware.node import Node
from sim.middleware.stamps import header, stamp_ns, time_message
from sim.middleware.tf import TransformBroadcaster, planar_transform, transforms_template
from sim.turtlebot3 import frames
from sim.turtlebot3.camera import add_depth_camera
from sim.turtlebot3.map import OdometrySource
from sim.turtlebot3.mjcf import WHEEL_RADIUS_M, WHEEL_SEPARATION_M
from sim.turtlebot3.wheel_odometry import WheelOdometry
from sim.turtlebot3.world import ImuSamples, World

_Clock = message_class("rosgraph_msgs/msg/Clock")
_Imu = message_class("sensor_msgs/msg/Imu")
_JointState = message_class("sensor_msgs/msg/JointState")
_LaserScan = message_class("sensor_msgs/msg/LaserScan")
_Odometry = message_class("nav_msgs/msg/Odometry")
_PerformanceMetrics = message_class("gazebo_msgs/msg/PerformanceMetrics")
_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Range = message_class("sensor_msgs/msg/Range")
_String = message_class("std_msgs/msg/String")
_Transform = message_class("geometry_msgs/msg/Transform")
_TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
_Twist = message_class("geometry_msgs/msg/Twist")
_TwistWithCovariance = message_class("geometry_msgs/msg/TwistWithCovariance")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_IMU = "sensor_msgs/msg/Imu"
_JOINT_STATE = "sensor_msgs/msg/JointState"
_ODOMETRY = "nav_msgs/msg/Odometry"

# Of the diff drive's pose and of its twist: x, y and yaw, as good as the plugin says they are.
_ODOMETRY_COVARIANCE = np.diag([1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3]).ravel()
_ODOMETRY_COVARIANCE.setflags(write=False)
_WHEEL_ROTATIONS = [mount.quaternion() for mount in frames.WHEELS]

Ranges = NDArray[np.float64]

CLOCK_NS = 100 * MILLISECOND
METRICS_NS = 200 * MILLISECOND
ODOMETRY_NS = 34 * MILLISECOND  # 30 Hz asked for, in steps of 1 ms
SCAN_NS = 200 * MILLISECOND
WHEEL_TF_NS = 50 * MILLISECOND

SCAN_RAYS = 360
SCAN_ANGLE_MAX = 6.28  # [rad]
SCAN_RANGE_MIN_M, SCAN_RANGE_MAX_M = 0.12, 20.0

INFRARED = 1  # sensor_msgs/msg/Range.radiation_type
INFRARED_VIEW = 0.2  # [rad]
INFRARED_MIN_M, INFRARED_MAX_M = 0.05, 2.0
_INFRARED_RAYS = 9

GYRO_NOISE = 2e-4  # standard deviation [rad/s]
ACCELEROMETER_NOISE = 1.7e-2  # standard deviation [m/s^2]

WHEEL_ACCELERATION = 1.0  # at the rim [m/s^2]
_CLOSE_ENOUGH = 0.01  # wheel speeds this close to their target are set to it [m/s]


@dataclass(frozen=True, slots=True)
class LidarNoise:
    """How a LiDAR errs."""

    sd_m: float = 0.01  # standard deviation of each range
    bias_m: float = 0.0  # of all ranges


class Gazebo(Node):
    """The server: ``/clock`` and its own performance."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/gazebo")
        self._clock = self.create_publisher("rosgraph_msgs/msg/Clock", "/clock", qos.CLOCK)
        self._metrics = self.create_publisher(
            "gazebo_msgs/msg/PerformanceMetrics", "/performance_metrics"
        )
        self.create_timer(CLOCK_NS, self._tick)
        self.create_timer(METRICS_NS, self._report)

    def _tick(self) -> None:
        self._clock.publish(_Clock(time_message(self.now_ns)))

    def _report(self) -> None:
        # Simulated time knows nothing of the real time it took.
        self._metrics.publish(_PerformanceMetrics(header(self.now_ns, ""), 1.0, []))


class ImuPlugin(Node):
    """``/imu``: orientation, turning speed, acceleration, with noise on the last two.

    The samples of an odometry period are measured in one go, at its start: until it ends nothing
    acts on the robot that does not act at its start.

    Parameters
    ----------
    domain, rng
        As for `Node`.
    measure
        What an ideal unit measures after now and up to a time [ns].
    """

    def __init__(
        self, domain: Domain, measure: Callable[[int], ImuSamples], rng: np.random.Generator
    ) -> None:
        super().__init__(domain, "/turtlebot3_imu", rng=rng)
        self._measure = measure
        self._publisher = self.create_publisher(_IMU, "/imu", qos.profile(5))
        self._template = Template(
            _Imu(
                header(0, "imu_link"),
                _Quaternion(0.0, 0.0, 0.0, 1.0),
                np.zeros(9),  # of the orientation: unknown
                _Vector3(0.0, 0.0, 0.0),
                np.diag([GYRO_NOISE**2] * 3).ravel(),
                _Vector3(0.0, 0.0, 0.0),
                np.diag([ACCELEROMETER_NOISE**2] * 3).ravel(),
            ),
            _IMU,
            (*STAMP, "orientation", "angular_velocity", "linear_acceleration"),
        )
        self.create_timer(ODOMETRY_NS, self._publish, phase_ns=0)

    def _publish(self) -> None:
        samples = self._measure(self.now_ns + ODOMETRY_NS)
        count = len(samples.stamps_ns)
        noise = self.rng.standard_normal((count, 6))
        rows = self._template.rows(count)
        for field, values in zip(STAMP, divmod(samples.stamps_ns, SECOND), strict=True):
            rows[field] = values
        rows["orientation"] = samples.orientations
        rows["angular_velocity"] = samples.angular_velocities + GYRO_NOISE * noise[:, :3]
        rows["linear_acceleration"] = (
            samples.linear_accelerations + ACCELEROMETER_NOISE * noise[:, 3:]
        )
        for due_ns, row in zip(samples.stamps_ns.tolist(), rows, strict=True):
            self.domain.executor.call_at(due_ns, self._publisher.publish_serialized, row.tobytes())


class LaserPlugin(Node):
    """A planar LiDAR of 360 rays (REP 117: inf no return, -inf too near).

    Parameters
    ----------
    domain, name, topic, mount
        The node, what it publishes, and in which frame.
    measure
        Exact ranges along bearings [rad] of the sensor's frame, up to a distance [m].
    noise, rng
        How it errs.
    phase_ns
        When in its period it fires.
    """

    def __init__(
        self,
        domain: Domain,
        name: str,
        topic: str,
        mount: frames.Mount,
        measure: Callable[[NDArray[np.float64], float], Ranges],
        noise: LidarNoise,
        rng: np.random.Generator,
        phase_ns: int,
    ) -> None:
        super().__init__(domain, name, rng=rng)
        self._frame = mount.child
        self._measure = measure
        self._noise = noise
        self._publisher = self.create_publisher("sensor_msgs/msg/LaserScan", topic, qos.profile(5))
        self._bearings = np.linspace(0.0, SCAN_ANGLE_MAX, SCAN_RAYS)
        self._intensities = np.zeros(SCAN_RAYS, np.float32)
        self.create_timer(SCAN_NS, self._publish, phase_ns=phase_ns)

    def _publish(self) -> None:
        exact = self._measure(self._bearings, SCAN_RANGE_MAX_M)
        ranges = noisy_ranges(exact, self._noise, self.rng)
        self._publisher.publish(
            _LaserScan(
                header(self.now_ns, self._frame),
                0.0,
                SCAN_ANGLE_MAX,
                SCAN_ANGLE_MAX / (SCAN_RAYS - 1),
                0.0,
                0.0,
                SCAN_RANGE_MIN_M,
                SCAN_RANGE_MAX_M,
                ranges,
                self._intensities,
            )
        )


def noisy_ranges(exact: Ranges, noise: LidarNoise, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return what a LiDAR reports of exact ranges [m]; one draw a ray, whatever it hits."""
    measured = exact + noise.bias_m + noise.sd_m * rng.standard_normal(len(exact))
    measured[measured > SCAN_RANGE_MAX_M] = np.inf
    measured[measured < SCAN_RANGE_MIN_M] = -np.inf
    return measured.astype(np.float32)


class RangePlugin(Node):
    """``/range_ella``: the nearest thing in a narrow infrared cone ahead."""

    def __init__(
        self,
        domain: Domain,
        measure: Callable[[NDArray[np.float64], float], Ranges],
        rng: np.random.Generator,
        phase_ns: int,
    ) -> None:
        super().__init__(domain, "/turtlebot3_range_ella", rng=rng)
        self._measure = measure
        self._bearings = np.linspace(-INFRARED_VIEW / 2, INFRARED_VIEW / 2, _INFRARED_RAYS)
        self._publisher = self.create_publisher(
            "sensor_msgs/msg/Range", "/range_ella", qos.profile(5)
        )
        self.create_timer(SCAN_NS, self._publish, phase_ns=phase_ns)

    def _publish(self) -> None:
        nearest = float(self._measure(self._bearings, INFRARED_MAX_M).min())
        measured = nearest + LidarNoise().sd_m * self.rng.standard_normal()
        if measured > INFRARED_MAX_M:
            measured = math.inf
        elif measured < INFRARED_MIN_M:
            measured = -math.inf
        self._publisher.publish(
            _Range(
                header(self.now_ns, frames.RANGE_ELLA.child),
                INFRARED,
                INFRARED_VIEW,
                INFRARED_MIN_M,
                INFRARED_MAX_M,
                measured,
            )
        )


class DiffDrivePlugin(Node):
    """``/cmd_vel`` in; wheel speeds, ``/odom`` and ``odom -> base_footprint`` out.

    The last command is held for ever, and each update moves the wheels' set-points by at most the
    acceleration's share. Odometry comes from one of the plugin's two sources (`wheel_odometry`).
    """

    def __init__(
        self,
        domain: Domain,
        odometry: Callable[[], tuple[Pose2D, tuple[float, float]]],
        command_wheels: Callable[[float, float], None],
    ) -> None:
        super().__init__(domain, "/turtlebot3_diff_drive")
        self._odometry = odometry
        self._command_wheels = command_wheels
        self._target = (0.0, 0.0)  # rim speeds, left and right [m/s]
        self._set_point = (0.0, 0.0)
        self._publisher = self.create_publisher(_ODOMETRY, "/odom", qos.RELIABLE)
        self._tf = TransformBroadcaster(self)
        self._odometry_bytes = Template(
            _odometry_message(0, Pose2D(), 0.0, 0.0),
            _ODOMETRY,
            (*STAMP, "pose.pose", "twist.twist"),
        )
        self._tf_bytes = transforms_template([_odom_transform(0, Pose2D())])
        self.create_subscription(
            "geometry_msgs/msg/Twist", "/cmd_vel", self._on_command, qos.RELIABLE
        )
        self.create_timer(ODOMETRY_NS, self._update)

    def _on_command(self, twist: Any) -> None:
        turn = twist.angular.z * WHEEL_SEPARATION_M / 2.0
        self._target = (twist.linear.x - turn, twist.linear.x + turn)

    def _update(self) -> None:
        left, right = self._set_point = next_set_point(self._set_point, self._target)
        self._command_wheels(left / WHEEL_RADIUS_M, right / WHEEL_RADIUS_M)
        pose, (forward, turning) = self._odometry()
        now_ns = self.now_ns
        stamp = divmod(now_ns, SECOND)
        where = (pose.x, pose.y, 0.0, *yaw_quaternion(pose.yaw))
        self._publisher.publish(
            _odometry_message(now_ns, pose, forward, turning),
            self._odometry_bytes.data(*stamp, where, (forward, 0.0, 0.0, 0.0, 0.0, turning)),
        )
        self._tf.send([_odom_transform(now_ns, pose)], self._tf_bytes.data(*stamp, where))


def _odometry_message(time_ns: int, pose: Pose2D, forward: float, turning: float) -> Any:
    return _Odometry(
        header(time_ns, "odom"),
        "base_footprint",
        _PoseWithCovariance(
            _Pose(_Point(pose.x, pose.y, 0.0), _Quaternion(*yaw_quaternion(pose.yaw))),
            _ODOMETRY_COVARIANCE,
        ),
        _TwistWithCovariance(
            _Twist(_Vector3(forward, 0.0, 0.0), _Vector3(0.0, 0.0, turning)), _ODOMETRY_COVARIANCE
        ),
    )


def _odom_transform(time_ns: int, pose: Pose2D) -> Any:
    return planar_transform(time_ns, "odom", "base_footprint", pose)


def next_set_point(now: tuple[float, float], target: tuple[float, float]) -> tuple[float, float]:
    """Return the wheels' next set-points [m/s], as Gazebo's diff drive moves them."""
    if all(abs(t - n) < _CLOSE_ENOUGH for n, t in zip(now, target, strict=True)):
        return target
    step = WHEEL_ACCELERATION * ODOMETRY_NS / SECOND
    left, right = (
        n + math.copysign(min(abs(t - n), step), t - n) for n, t in zip(now, target, strict=True)
    )
    return left, right


class JointStatePlugin(Node):
    """``/joint_states`` of the two wheels."""

    def __init__(
        self, domain: Domain, measure: Callable[[], tuple[list[float], list[float]]]
    ) -> None:
        super().__init__(domain, "/turtlebot3_joint_state")
        self._measure = measure
        self._publisher = self.create_publisher(_JOINT_STATE, "/joint_states", qos.profile(1000))
        self._bytes = Template(
            _joint_state(0, [0.0, 0.0], [0.0, 0.0]), _JOINT_STATE, (*STAMP, "position", "velocity")
        )
        self.create_timer(ODOMETRY_NS, self._publish)

    def _publish(self) -> None:
        angles, speeds = self._measure()
        stamp = divmod(self.now_ns, SECOND)
        self._publisher.publish(
            _joint_state(self.now_ns, angles, speeds), self._bytes.data(*stamp, angles, speeds)
        )


def _joint_state(time_ns: int, angles: list[float], speeds: list[float]) -> Any:
    names = list(frames.WHEEL_JOINTS)
    no_effort = np.zeros(0)
    return _JointState(header(time_ns, ""), names, np.array(angles), np.array(speeds), no_effort)


class RobotStatePublisher(Node):
    """The robot's frames: the fixed ones once, the wheels' at up to 20 Hz."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/robot_state_publisher")
        description = self.create_publisher(
            "std_msgs/msg/String", "/robot_description", qos.LATCHED
        )
        self._tf = TransformBroadcaster(self)
        static = TransformBroadcaster(self, static=True)
        self._last_ns = -WHEEL_TF_NS
        self.create_subscription("sensor_msgs/msg/JointState", "/joint_states", self._on_joints)
        self._tf_bytes = transforms_template(
            [_transform(0, mount, mount.quaternion()) for mount in frames.WHEELS]
        )
        description.publish(_String(frames.robot_description()))
        static.send([_transform(self.now_ns, mount, mount.quaternion()) for mount in frames.STATIC])

    def _on_joints(self, state: Any) -> None:
        now_ns = stamp_ns(state.header.stamp)
        # The original compares with its own clock too, which /clock moves on ten times a second:
        # hence 19.4 Hz on Humble, not the 14.7 Hz of every second joint state.
        clock_ns = now_ns - now_ns % CLOCK_NS
        if now_ns < min(clock_ns, self._last_ns) + WHEEL_TF_NS:
            return
        self._last_ns = now_ns
        stamp = divmod(now_ns, SECOND)
        turned = [
            _turned(rotation, angle)
            for rotation, angle in zip(_WHEEL_ROTATIONS, state.position.tolist(), strict=True)
        ]
        wheels = list(zip(frames.WHEELS, turned, strict=True))
        self._tf.send(
            [_transform(now_ns, mount, rotation) for mount, rotation in wheels],
            self._tf_bytes.data(
                *(part for mount, turn in wheels for part in (*stamp, (*mount.xyz, *turn)))
            ),
        )


def _turned(
    quaternion: tuple[float, float, float, float], angle: float
) -> tuple[float, float, float, float]:
    """Return a rotation (x, y, z, w) followed by a turn about its own z axis."""
    x, y, z, w = quaternion
    s, c = math.sin(angle / 2.0), math.cos(angle / 2.0)
    return x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s


def _transform(
    time_ns: int, mount: frames.Mount, quaternion: tuple[float, float, float, float]
) -> Any:
    return _TransformStamped(
        header(time_ns, mount.parent),
        mount.child,
        _Transform(_Vector3(*mount.xyz), _Quaternion(*quaternion)),
    )


def add_robot(
    domain: Domain,
    world: World,
    lidar_noise: LidarNoise,
    generator: Callable[[str], np.random.Generator],
    *,
    odometry_source: OdometrySource = "world",
    cameras: bool = False,
) -> None:
    """Put the simulator's and the robot's nodes into a domain.

    Parameters
    ----------
    domain, world
        The graph, and the physics that its measurements come from.
    lidar_noise
        Of both LiDARs.
    generator
        Gives each node, by name, its randomness.
    odometry_source
        ``world``: odometry is the ground truth; ``encoder``: it is summed up from the wheels.
    cameras
        Whether there is a rendering context, without which the depth camera is silent.
    """
    Gazebo(domain)
    # The LiDARs and the infrared are separate devices: each fires at its own moment.
    lidars = (
        ("/turtlebot3_laserscan", "/scan", frames.BASE_SCAN, 200),
        ("/turtlebot3_laserscan_tom", "/scan_tom", frames.BASE_SCAN_TOM, 260),
    )
    for name, topic, mount, phase_ms in lidars:
        LaserPlugin(
            domain, name, topic, mount, _rays(world, mount), lidar_noise, generator(name),
            phase_ms * MILLISECOND,
        )  # fmt: skip
    RangePlugin(
        domain,
        _rays(world, frames.RANGE_ELLA),
        generator("/turtlebot3_range_ella"),
        330 * MILLISECOND,
    )
    DiffDrivePlugin(
        domain,
        WheelOdometry(world.wheel_states)
        if odometry_source == "encoder"
        else lambda: (world.pose, world.twist),
        world.command_wheels,
    )
    # After the diff drive: it measures what comes of the command that was just given.
    ImuPlugin(domain, world.imu, generator("/turtlebot3_imu"))
    JointStatePlugin(domain, world.wheel_states)
    add_depth_camera(domain, world, renders=cameras)
    RobotStatePublisher(domain)


def _rays(world: World, mount: frames.Mount) -> Callable[[NDArray[np.float64], float], Ranges]:
    """Return a sensor's view of the world: ranges along bearings of its own frame."""
    x, y, z = mount.xyz
    pose, height = Pose2D(x, y), z + frames.STATIC[0].xyz[2]
    return lambda bearings, range_max: world.scan(pose, height, bearings, range_max)
