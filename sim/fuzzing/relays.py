"""Three nodes between ``/scan_tom`` and ``/scan_fakeobject``: hand on, add noise, add an object.

All go by the same name and have the endpoints of their pair, so that nothing but the payload
tells an attack from its control. What they changed goes to the hidden ground-truth topic.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.geometry import Pose2D, quaternion_yaw
from sim.middleware.node import Node

NAME = "/lidar_passthrough"
INPUT_TOPIC = "/scan_tom"
ATTACKED_TOPIC = "/scan_fakeobject"

_GroundTruth = message_class(GROUND_TRUTH_TYPE)
_SCAN = "sensor_msgs/msg/LaserScan"
Ranges = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class FakeObject:
    """A cylinder that is not there."""

    x: float  # [m]
    y: float  # [m]
    radius: float  # [m]


class Relay(Node):
    """Hand every scan on unchanged: the control of every attack.

    Parameters
    ----------
    domain
        Where the node lives.
    with_odometry
        Also listen to ``/odom``, as the fake object must.
    latency_ns
        From hearing a scan to having handed it on.
    shadow
        Work the mutation out and hand the scan on unchanged: what an attack's own load does.
    """

    operation = "passthrough"

    def __init__(
        self, domain: Domain, *, with_odometry: bool, latency_ns: int, shadow: bool = False
    ) -> None:
        super().__init__(domain, NAME, latency_ns=latency_ns)
        self._shadow = shadow
        self._messages = 0
        self._output = self.create_publisher(_SCAN, ATTACKED_TOPIC, qos.DEFAULT)
        self._truth = self.create_publisher(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, qos.DEFAULT)
        self.create_subscription(_SCAN, INPUT_TOPIC, self._on_scan, qos.SENSOR_DATA)
        if with_odometry:
            self.create_subscription("nav_msgs/msg/Odometry", "/odom", self.on_odometry)

    def mutate(self, scan: Any, index: int) -> Ranges:  # noqa: ARG002 -- others draw by it
        """Return the ranges to publish in place of the ``index``-th scan's."""
        ranges: Ranges = scan.ranges
        return ranges

    def on_odometry(self, odometry: Any) -> None:
        """Hear where the robot is; the control has no use for it."""

    def _on_scan(self, scan: Any) -> None:
        ranges = self.mutate(scan, self._messages)
        if self._shadow:
            ranges = scan.ranges
        changed = ranges != scan.ranges
        with np.errstate(invalid="ignore"):
            change = np.abs(ranges - scan.ranges)[changed & np.isfinite(ranges)]
        self._output.publish(scan if ranges is scan.ranges else replace(scan, ranges=ranges))
        self._truth.publish(
            _GroundTruth(
                scan.header.stamp,
                ATTACKED_TOPIC,
                self._messages,
                self.operation,
                float(change.max(initial=0.0)),
                f"{int(changed.sum())} of {len(ranges)} ranges",
            )
        )
        self._messages += 1


class NoiseRelay(Relay):
    """Scale every range by an independent factor drawn from [1 - level, 1 + level].

    Ranges without a return stay as they are and the others stay within the sensor's limits. The
    draw of message i depends on the seed and i only, whatever was lost before.
    """

    operation = "random_noise"

    def __init__(
        self,
        domain: Domain,
        *,
        level: float,
        seed: int,
        with_odometry: bool,
        latency_ns: int,
        shadow: bool = False,
    ) -> None:
        super().__init__(domain, with_odometry=with_odometry, latency_ns=latency_ns, shadow=shadow)
        self._level = level
        self._seed = seed

    def mutate(self, scan: Any, index: int) -> Ranges:
        """Return the noisy ranges."""
        counter = np.random.Philox(key=self._seed, counter=index << 64)
        factors = 1.0 + np.random.Generator(counter).uniform(
            -self._level, self._level, len(scan.ranges)
        )
        noisy = np.clip(scan.ranges * factors, scan.range_min, scan.range_max)
        ranges: Ranges = np.where(np.isfinite(scan.ranges), noisy, scan.ranges)
        return ranges.astype(np.float32)


class FakeObjectRelay(Relay):
    """Shorten the rays that a cylinder would stop, wherever no wall stops them before."""

    operation = "fake_object"

    def __init__(
        self,
        domain: Domain,
        *,
        target: FakeObject,
        mount: Pose2D,
        latency_ns: int,
        shadow: bool = False,
    ) -> None:
        super().__init__(domain, with_odometry=True, latency_ns=latency_ns, shadow=shadow)
        self._target = target  # in the odometry frame
        self._mount = mount  # of the LiDAR in the robot's frame
        self._sensor: Pose2D | None = None  # in the odometry frame

    def on_odometry(self, odometry: Any) -> None:
        """Keep where the sensor is."""
        position, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        robot = Pose2D(position.x, position.y, quaternion_yaw(q.x, q.y, q.z, q.w))
        self._sensor = robot.compose(self._mount)

    def mutate(self, scan: Any, index: int) -> Ranges:  # noqa: ARG002 -- nothing is drawn here
        """Return the ranges with the cylinder in them."""
        ranges: Ranges = scan.ranges
        if self._sensor is None:
            return ranges
        bearings = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        hits = ray_circle(bearings, self._sensor, self._target)
        visible = (hits >= scan.range_min) & (hits <= scan.range_max)
        ranges = np.where(visible, np.fmin(scan.ranges, hits), scan.ranges)
        return ranges.astype(np.float32)


def ray_circle(
    bearings: NDArray[np.float64], sensor: Pose2D, target: FakeObject
) -> NDArray[np.float64]:
    """Return how far each ray goes until it meets a circle.

    Parameters
    ----------
    bearings : ndarray of shape (n,)
        Of the rays, in the sensor's frame [rad].
    sensor, target
        Both in the same frame.

    Returns
    -------
    ndarray of shape (n,)
        Distance [m]; ``inf`` for a ray that misses, and for all if the sensor is inside.
    """
    dx, dy = target.x - sensor.x, target.y - sensor.y
    distance = math.hypot(dx, dy)
    if distance <= target.radius:
        return np.full(len(bearings), np.inf)
    off_axis = bearings - (math.atan2(dy, dx) - sensor.yaw)
    half_chord_squared = target.radius**2 - (distance * np.sin(off_axis)) ** 2
    along = distance * np.cos(off_axis)
    meets = (half_chord_squared >= 0.0) & (along > 0.0)
    return np.where(meets, along - np.sqrt(np.maximum(half_chord_squared, 0.0)), np.inf)
