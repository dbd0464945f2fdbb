"""AMCL: the robot's pose on the map, from odometry and laser scans.

The mathematics of the filter is in ``particle_filter`` and ``likelihood_field``. This module has
the topics, the transforms, and the conditions under which a scan updates the filter.
"""

import struct
from typing import Any

import numpy as np

from oracle_pipeline.bags.cdr import ENCAPSULATION, aligned
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D, pose_yaw, wrap_angle, yaw_quaternion
from sim.middleware.stamps import header, stamp_ns
from sim.middleware.tf import (
    TransformBroadcaster,
    TransformBuffer,
    TransformError,
    planar_transform,
    transforms_template,
)
from sim.nav2.laser import beam_bearings
from sim.nav2.lifecycle import LifecycleNode, nothing
from sim.nav2.likelihood_field import LikelihoodField
from sim.nav2.messages import POSE_ESTIMATE, pose_estimate
from sim.nav2.particle_filter import MAX_PARTICLES, ParticleFilter

_ParticleCloud = message_class("nav2_msgs/msg/ParticleCloud")

MAP_FRAME = "map"
ODOM_FRAME = "odom"
BASE_FRAME = "base_footprint"
MAX_BEAMS = 60
UPDATE_MIN_D = 0.25  # along one axis of the odometry frame [m]
UPDATE_MIN_A = 0.2  # [rad]
TRANSFORM_TOLERANCE_NS = SECOND  # how long map -> odom stays valid after its scan
LASER_MAX_RANGE = 100.0  # [m]
_SERVICES = (
    ("std_srvs/srv/Empty", "/reinitialize_global_localization"),
    ("std_srvs/srv/Empty", "/request_nomotion_update"),
    ("nav2_msgs/srv/SetInitialPose", "/set_initial_pose"),
)
_RETRY_NS = 10 * MILLISECOND
_CLOUD_TYPE = "nav2_msgs/msg/ParticleCloud"
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])  # x, y and yaw in a 6x6 covariance


class Amcl(LifecycleNode):
    """Localises the robot and publishes map -> odom; silent before the initial pose.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    transforms
        What its transform listener fills.
    rng
        Generator for the motion and the resampling of particles.
    latency_ns
        From a scan's publication to its arrival.
    """

    def __init__(
        self,
        domain: Domain,
        transforms: TransformBuffer,
        *,
        rng: np.random.Generator,
        latency_ns: int = 0,
    ) -> None:
        super().__init__(domain, "/amcl", rng=rng, latency_ns=latency_ns)
        self._transforms = transforms
        self._broadcaster = TransformBroadcaster(self)
        self._transform_bytes = transforms_template(
            [planar_transform(0, MAP_FRAME, ODOM_FRAME, Pose2D())]
        )
        self._empty_cloud = Template(_ParticleCloud(header(0, MAP_FRAME), []), _CLOUD_TYPE, STAMP)
        self._field: LikelihoodField | None = None
        self._filter: ParticleFilter | None = None
        self._updated_at: Pose2D | None = None  # robot in odom at the last update
        self._map_to_odom: Pose2D | None = None
        self._scan: Any = None  # the latest one

        self._pose = self.create_publisher(POSE_ESTIMATE, "/amcl_pose", qos.LATCHED)
        self._cloud = self.create_publisher(_CLOUD_TYPE, "/particle_cloud", qos.SENSOR_DATA)
        for srvtype, service in _SERVICES:
            self.create_service(srvtype, service, nothing)

    def on_configure(self) -> None:
        """Subscribe to map, scans and initial poses."""
        self.create_subscription("nav_msgs/msg/OccupancyGrid", "/map", self._on_map, qos.LATCHED)
        self.create_subscription(
            "sensor_msgs/msg/LaserScan", "/scan", self._on_scan, qos.SENSOR_DATA
        )
        self.create_subscription(POSE_ESTIMATE, "/initialpose", self._on_pose, qos.SYSTEM)

    # -- input -----------------------------------------------------------------------------

    def _on_map(self, message: Any) -> None:
        meta = message.info
        occupancy = message.data.reshape(meta.height, meta.width)
        corner = meta.origin.position
        self._field = LikelihoodField(occupancy, meta.resolution, corner.x, corner.y)

    def _on_pose(self, message: Any) -> None:
        """Restart around a ``PoseWithCovarianceStamped`` in the map frame."""
        position = message.pose.pose.position
        mean = np.array([position.x, position.y, pose_yaw(message.pose.pose)])
        covariance = np.reshape(message.pose.covariance, (6, 6))[_PLANAR]
        poses = self.rng.multivariate_normal(mean, covariance, MAX_PARTICLES, method="eigh")
        self._filter = ParticleFilter(poses, self.rng)
        self._updated_at = None

    def _on_scan(self, scan: Any) -> None:
        self._scan = scan
        self._process(scan)

    def _process(self, scan: Any) -> None:
        """Use a scan as soon as odometry at its stamp is known, unless a newer one came."""
        if scan is not self._scan or not self.is_active:
            return
        if self._field is None or self._filter is None:
            return
        time_ns = stamp_ns(scan.header.stamp)
        try:
            odom = self._transforms.lookup(ODOM_FRAME, BASE_FRAME, time_ns)
            laser = self._transforms.lookup(BASE_FRAME, scan.header.frame_id, time_ns)
        except TransformError:
            self.call_later(_RETRY_NS, self._process, scan)
            return
        if self._updated_at is None:
            self._update(self._field, self._filter, scan, odom, laser)
        elif _has_moved(self._updated_at, odom):
            self._filter.move(self._updated_at, odom)
            self._update(self._field, self._filter, scan, odom, laser)
        self._send_transform(time_ns)

    # -- output ----------------------------------------------------------------------------

    def _update(
        self, field: LikelihoodField, belief: ParticleFilter, scan: Any, odom: Pose2D, laser: Pose2D
    ) -> None:
        """Weigh and resample the particles by a scan; publish cloud and pose."""
        range_max = min(scan.range_max, LASER_MAX_RANGE)
        belief.weigh(field.weights(belief.poses, laser.apply(_beams(scan, range_max)), range_max))
        belief.resample()
        self._updated_at = odom
        pose, covariance = belief.estimate()
        self._map_to_odom = pose.compose(odom.inverse())
        empty = self._empty_cloud.data(*self.stamp)
        self._cloud.publish_serialized(_cloud_data(empty, belief))
        full = np.zeros((6, 6))
        full[_PLANAR] = covariance
        time_ns = stamp_ns(scan.header.stamp)
        self._pose.publish(pose_estimate(time_ns, pose, full.ravel()))

    def _send_transform(self, time_ns: int) -> None:
        if self._map_to_odom is not None:
            valid_ns = time_ns + TRANSFORM_TOLERANCE_NS
            pose = self._map_to_odom
            self._broadcaster.send(
                [planar_transform(valid_ns, MAP_FRAME, ODOM_FRAME, pose)],
                self._transform_bytes.data(
                    *divmod(valid_ns, SECOND), (pose.x, pose.y, 0.0, *yaw_quaternion(pose.yaw))
                ),
            )


def _has_moved(before: Pose2D, after: Pose2D) -> bool:
    """Return whether the robot moved enough for an update; each axis is tested separately."""
    return (
        abs(after.x - before.x) > UPDATE_MIN_D
        or abs(after.y - before.y) > UPDATE_MIN_D
        or abs(wrap_angle(after.yaw - before.yaw)) > UPDATE_MIN_A
    )


def _beams(scan: Any, range_max: float) -> Floats:
    """Return the ends of the beams that AMCL uses, in the sensor frame, shape (n, 2) [m].

    Readings without a return, and readings below the smallest range, are left out.
    """
    step = max(1, (len(scan.ranges) - 1) // (MAX_BEAMS - 1))
    ranges = scan.ranges[::step].astype(np.float64)
    hit = (ranges > scan.range_min) & (ranges < range_max)
    points: Floats = ranges[hit, np.newaxis] * beam_bearings(scan)[::step][hit]
    return points


def _cloud_data(empty: bytes, belief: ParticleFilter) -> bytes:
    """Return ``nav2_msgs/msg/ParticleCloud`` as CDR bytes, from those of one without particles.

    Written from arrays: two thousand message objects would cost more than the filter itself.
    """
    before_count = empty[: -struct.calcsize("<I")]
    count = len(belief.poses)
    # x, y, z, quaternion x, y, z, w, weight; float64 is aligned to 8 behind the encapsulation.
    particles = np.zeros((count, 8))
    particles[:, :2] = belief.poses[:, :2]
    particles[:, 5] = np.sin(belief.poses[:, 2] / 2.0)
    particles[:, 6] = np.cos(belief.poses[:, 2] / 2.0)
    particles[:, 7] = belief.weights
    prefix = before_count + struct.pack("<I", count)
    size = len(prefix) - len(ENCAPSULATION)
    padding = bytes(aligned(size, 8) - size)
    return b"".join((prefix, padding, particles.astype("<f8", copy=False).data))
