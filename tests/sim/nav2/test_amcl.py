import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from oracle_pipeline.bags.types import deserialize, message_class
from sim.middleware import qos
from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D, pose_yaw, wrap_angle
from sim.middleware.stamps import header, stamp_ns
from sim.nav2 import particle_filter
from sim.nav2.amcl import Amcl
from sim.nav2.likelihood_field import LikelihoodField
from sim.nav2.map_server import MapServer, OccupancyMap
from sim.nav2.messages import pose_message, twist_message
from sim.nav2.particle_filter import (
    MAX_PARTICLES,
    MIN_PARTICLES,
    ParticleFilter,
    cluster_labels,
    kld_limits,
)
from tests.sim.nav2.robot import IdealRobot

LaserScan = message_class("sensor_msgs/msg/LaserScan")
PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
PoseWithCovarianceStamped = message_class("geometry_msgs/msg/PoseWithCovarianceStamped")
CLOUD = "nav2_msgs/msg/ParticleCloud"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"

RESOLUTION = 0.05


def room(width, height):
    """A map of a room whose inside reaches from (0, 0) to (width, height) [m], walls one cell."""
    columns, rows = round(width / RESOLUTION), round(height / RESOLUTION)
    data = np.full((rows + 2, columns + 2), 100, np.int8)
    data[1:-1, 1:-1] = 0
    return OccupancyMap(data, RESOLUTION, (-RESOLUTION, -RESOLUTION))


def room_field(width, height):
    a_map = room(width, height)
    return LikelihoodField(a_map.data, a_map.resolution, *a_map.origin)


def ranges_in_room(pose, angles, width, height):
    """Distances from a pose to the walls of a room."""
    dx, dy = np.cos(pose.yaw + angles), np.sin(pose.yaw + angles)
    with np.errstate(divide="ignore"):
        to_x = np.where(dx > 0, (width - pose.x) / dx, -pose.x / dx)
        to_y = np.where(dy > 0, (height - pose.y) / dy, -pose.y / dy)
    return np.minimum(to_x, to_y)


def gaussian(mean, deviations, count=MAX_PARTICLES, seed=0):
    rng = np.random.default_rng(seed)
    return ParticleFilter(mean + deviations * rng.standard_normal((count, 3)), rng)


# -- likelihood field ------------------------------------------------------------------------


def one_obstacle():
    occupancy = np.zeros((60, 60), np.int8)
    occupancy[30, 30] = 100
    occupancy[0, 0] = -1  # unknown is no obstacle
    return LikelihoodField(occupancy, RESOLUTION, 0.0, 0.0)


def score(distance):
    return (0.5 * math.exp(-(distance**2) / (2 * 0.2**2)) + 0.5 / 20.0) ** 3


@pytest.mark.parametrize(
    ("end", "distance"),
    [
        ((1.51, 1.54), 0.0),
        ((1.66, 1.51), 0.15),
        ((1.66, 1.31), 0.25),
        ((0.01, 0.01), 2.0),  # 2.1 m away: capped
        *((end, 2.0) for end in [(-1.0, 1.0), (9.0, 1.0), (1.0, -1.0), (1.0, 9.0)]),  # off the map
        *((end, 2.0) for end in [(math.nan, math.nan), (1.5, math.nan), (math.nan, 1.5)]),
        *((end, 2.0) for end in [(math.inf, 1.5), (1.5, -math.inf)]),
    ],
)
def test_beam_scores_by_its_distance_from_the_nearest_obstacle(end, distance):
    weights = one_obstacle().weights(np.zeros((1, 3)), np.array([end]), 20.0)
    assert weights == pytest.approx([1.0 + score(distance)])


def test_scores_of_beams_add_up_in_the_particles_frame():
    points = np.array([[0.5, 0.0], [0.0, 0.5]])
    poses = np.array([[1.525, 1.025, math.pi / 2.0], [1.525, 1.025, 0.0], [1.525, 1.025, 0.3]])
    weights = one_obstacle().weights(poses, points, 20.0)
    # Turned left, the first beam hits; straight on, the second does.
    other = math.hypot(0.5, 0.5)
    assert weights[0] == pytest.approx(1.0 + score(0.0) + score(other), rel=1e-3)
    assert weights[1] == pytest.approx(weights[0], rel=1e-3)
    assert weights[2] < weights[0]


def test_map_without_obstacles_is_refused():
    with pytest.raises(ValueError, match="no occupied cell"):
        LikelihoodField(np.zeros((5, 5), np.int8), RESOLUTION, 0.0, 0.0)


# -- particle filter -------------------------------------------------------------------------


def test_kld_limits_are_foxs_formula_between_500_and_2000():
    limits = kld_limits()
    assert limits[1] == MAX_PARTICLES  # AMCL's quirk: one bin needs all
    assert limits[2] == MIN_PARTICLES
    assert limits[100] == 1129  # 990 * (1 - 0.0022447 + 0.0473795 * 0.99)^3, rounded up
    assert limits[-1] == MAX_PARTICLES
    assert np.all(np.diff(limits[2:]) >= 0)


def test_tight_filter_keeps_all_particles_and_a_loose_one_few():
    tight = gaussian([0.25, 0.25, 0.09], [0.01, 0.01, 0.01])
    tight.resample()
    assert len(tight.poses) == MAX_PARTICLES
    loose = gaussian([0.0, 0.0, 0.0], [0.05, 0.05, 0.01])  # around the corner of bins
    loose.resample()
    assert MIN_PARTICLES <= len(loose.poses) < 700
    assert loose.weights.sum() == pytest.approx(1.0)


def test_resampling_draws_in_proportion_to_the_weights():
    belief = ParticleFilter(np.array([[0.1, 0.1, 0.1], [5.1, 0.1, 0.1]]), np.random.default_rng(3))
    belief.weigh(np.array([3.0, 1.0]))
    belief.resample()
    share = np.mean(belief.poses[:, 0] < 1.0)
    assert share == pytest.approx(0.75, abs=4 * math.sqrt(0.75 * 0.25 / len(belief.poses)))


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_standing_still_moves_no_particle(x, y, yaw):
    belief = gaussian([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], 50)
    before = belief.poses.copy()
    belief.move(Pose2D(x, y, yaw), Pose2D(x, y, yaw))
    assert belief.poses == pytest.approx(before)


poses = st.builds(Pose2D, st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3))


@given(poses, st.floats(-0.3, 0.3), st.floats(-0.5, 0.5))
def test_particles_move_as_odometry_does_on_average(before, forward, turn):
    step = Pose2D(forward * math.cos(turn / 2), forward * math.sin(turn / 2), turn)
    belief = gaussian([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    belief.move(before, before.compose(step))
    x, y, yaw = belief.poses.mean(axis=0)
    assert math.dist((x, y), (step.x, step.y)) < 0.03
    assert abs(wrap_angle(yaw - step.yaw)) < 0.03


def test_driving_straight_spreads_particles_by_alpha():
    belief = gaussian([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    belief.move(Pose2D(), Pose2D(0.1, 0.0, 0.0))
    slip = math.sqrt(0.2) * 0.1  # of the distance [m] and of both turns [rad]
    travelled = np.hypot(belief.poses[:, 0], belief.poses[:, 1])
    assert travelled.std() == pytest.approx(slip, rel=0.1)
    assert belief.poses[:, 2].std() == pytest.approx(math.sqrt(2.0) * slip, rel=0.1)


def test_estimate_is_the_mean_of_the_heaviest_cluster_not_of_all():
    rng = np.random.default_rng(0)
    heavy = [1.0, 2.0, math.pi] + 0.02 * rng.standard_normal((700, 3))  # across the turn's seam
    light = [8.0, 2.0, 0.0] + 0.02 * rng.standard_normal((300, 3))
    belief = ParticleFilter(np.vstack([light, heavy]), rng)
    mean, covariance = belief.estimate()
    assert (mean.x, mean.y) == pytest.approx((1.0, 2.0), abs=0.005)
    assert abs(wrap_angle(mean.yaw - math.pi)) < 0.005
    assert covariance[0, 0] == pytest.approx(0.7 * 0.3 * 49.0, rel=0.02)


def test_covariance_of_four_particles():
    poses = np.array([[1.0, 2.0, 0.3], [1.0, 4.0, -0.3], [3.0, 2.0, -0.3], [3.0, 4.0, 0.3]])
    _, covariance = ParticleFilter(poses, np.random.default_rng(0)).estimate()
    # Yaw goes with x and y, but only its circular variance is published.
    assert covariance == pytest.approx(np.diag([1.0, 1.0, -2.0 * math.log(math.cos(0.3))]))


def test_clusters_are_bins_that_touch():
    half, ten = 0.5, math.radians(10.0)
    bins = np.array([[0, 0, 0], [1, 1, 1], [3, 1, 1], [1, 2, 2], [0, 0, 35], [0, 0, 18]])
    labels = cluster_labels((bins + 0.5) * [half, half, ten])
    assert labels[0] == labels[1] == labels[3] == labels[4]
    assert len({labels[0], labels[2], labels[5]}) == 3


@pytest.mark.parametrize("spread_m", [0.5, 1.5, 5.0])
def test_clusters_are_what_can_be_reached_from_bin_to_touching_bin(spread_m):
    poses = np.random.default_rng(3).normal(0.0, spread_m, (60, 3))
    bins, first, bin_of = particle_filter._occupied_bins(poses)
    gaps = np.abs(bins[first, np.newaxis] - bins[np.newaxis, first])
    gaps[:, :, 2] = np.minimum(gaps[:, :, 2], 36 - gaps[:, :, 2])
    _, expected = connected_components(np.all(gaps <= 1, axis=2))
    assert cluster_labels(poses).tolist() == expected[bin_of].tolist()


def test_in_a_corridor_the_scan_determines_motion_across_but_not_along():
    field = room_field(20.0, 1.0)
    angles = np.radians([60, 75, 90, 105, 120, -60, -75, -90, -105, -120])
    ranges = ranges_in_room(Pose2D(10.0, 0.5, 0.0), angles, 20.0, 1.0)
    points = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    belief = gaussian([10.0, 0.5, 0.0], [0.5, 0.2, 0.1])
    for _ in range(20):
        belief.weigh(field.weights(belief.poses, points, 20.0))
    belief.resample()
    along, across, yaw = belief.poses.std(axis=0)
    assert along == pytest.approx(0.5, abs=0.05)
    assert across < 0.07
    assert yaw < 0.1
    assert belief.poses[:, 1].mean() == pytest.approx(0.5, abs=0.02)


# -- node ------------------------------------------------------------------------------------

WIDTH, HEIGHT = 4.0, 3.0


class Rig:
    """A robot that drives in a room, with a scanner, and AMCL; odometry begins at the origin."""

    def __init__(self, start=None):
        self.start = start or Pose2D(1.0, 1.5, 0.0)
        self.robot = IdealRobot("/cmd_vel")
        domain = self.robot.domain
        self.amcl = Amcl(domain, self.robot.buffer, rng=np.random.default_rng(5))
        server = MapServer(domain, room(WIDTH, HEIGHT))
        for node in (server, self.amcl):
            node.configure()
            node.activate()
        self.transforms, self.clouds, self.poses = [], [], []
        robot = self.robot
        robot.create_subscription("tf2_msgs/msg/TFMessage", "/tf", self._on_tf, qos.TF)
        robot.create_subscription(
            CLOUD, "/particle_cloud", self.clouds.append, qos.SENSOR_DATA, raw=True
        )
        robot.create_subscription(POSE, "/amcl_pose", self.poses.append, qos.LATCHED)
        self._scans = robot.create_publisher("sensor_msgs/msg/LaserScan", "/scan")
        self._initial = robot.create_publisher(POSE, "/initialpose")
        self._commands = robot.create_publisher("geometry_msgs/msg/Twist", "/cmd_vel")
        self._noise = np.random.default_rng(6)
        robot.create_timer(SECOND // 5, self._scan)

    def tell_initial_pose(self):
        covariance = np.zeros((6, 6))
        covariance[[0, 1, 5], [0, 1, 5]] = 0.25, 0.25, 0.0685
        pose = pose_message(self.start.x, self.start.y, self.start.yaw)
        self._initial.publish(
            PoseWithCovarianceStamped(
                header(self.robot.now_ns, "map"), PoseWithCovariance(pose, covariance.ravel())
            )
        )

    def drive(self, linear, angular, seconds):
        self._commands.publish(twist_message(linear, angular))
        self.robot.run(seconds)
        self._commands.publish(twist_message(0.0, 0.0))
        self.robot.run(0.5)

    @property
    def truth(self):
        return self.start.compose(self.robot.pose)

    def _on_tf(self, message):
        for transform in message.transforms:
            if transform.child_frame_id == "odom":
                translation, q = transform.transform.translation, transform.transform.rotation
                yaw = 2.0 * math.atan2(q.z, q.w)
                pose = Pose2D(translation.x, translation.y, yaw)
                self.transforms.append((stamp_ns(transform.header.stamp), pose))

    def _scan(self):
        angles = np.linspace(0.0, 6.28, 360)
        ranges = ranges_in_room(self.truth, angles, WIDTH, HEIGHT)
        ranges = (ranges + 0.01 * self._noise.standard_normal(360)).astype(np.float32)
        stamp = header(self.robot.now_ns, "base_footprint")
        self._scans.publish(
            LaserScan(
                stamp, 0.0, 6.28, 6.28 / 359, 0.0, 0.0, 0.12, 20.0, ranges, np.zeros(0, np.float32)
            )
        )


@pytest.fixture
def rig():
    return Rig()


def test_nothing_is_published_before_an_initial_pose(rig):
    rig.robot.run(5.0)
    assert rig.transforms == rig.clouds == rig.poses == []


def test_standing_robot_gets_one_update_and_a_transform_for_every_scan(rig):
    rig.robot.run(0.5)
    rig.tell_initial_pose()
    rig.robot.run(5.0)
    assert len(rig.clouds) == len(rig.poses) == 1
    stamps = [stamp for stamp, _ in rig.transforms]
    assert np.all(np.diff(stamps) == SECOND // 5)
    assert len(stamps) == pytest.approx(25, abs=1)
    # Valid for a second more than the scan; the scan came before now.
    assert 0.8 * SECOND <= stamps[-1] - rig.robot.now_ns <= SECOND


@pytest.mark.parametrize(
    ("x", "y", "yaw", "updates"),
    [
        (0.24, 0.24, 0.0, 0),  # 0.34 m, but not along one axis
        (0.26, 0.0, 0.0, 1),
        (0.0, -0.26, 0.0, 1),
        (0.0, 0.0, 0.19, 0),
        (0.0, 0.0, -0.21, 1),
    ],
)
def test_update_needs_a_move_along_one_axis_or_a_turn(rig, x, y, yaw, updates):
    rig.tell_initial_pose()
    rig.robot.run(1.0)
    rig.robot.pose = Pose2D(x, y, yaw)
    rig.robot.run(1.0)
    assert len(rig.poses) == 1 + updates


def test_driving_robot_is_found_within_a_few_centimetres(rig):
    rig.tell_initial_pose()
    rig.robot.run(1.0)
    errors = []
    for linear, angular, seconds in ((0.25, 0.0, 4.0), (0.0, 0.8, 2.0), (0.25, 0.3, 4.0)):
        rig.drive(linear, angular, seconds)
        estimate = rig.transforms[-1][1].compose(rig.robot.pose)
        errors.append(estimate.distance_to(rig.truth))
        assert abs(wrap_angle(estimate.yaw - rig.truth.yaw)) < 0.1
    assert max(errors) < 0.12
    assert np.median(errors) < 0.08


def test_pose_and_transform_agree(rig):
    rig.tell_initial_pose()
    rig.robot.run(1.0)
    rig.drive(0.25, 0.0, 2.0)
    pose = rig.poses[-1]
    assert pose.header.frame_id == "map"
    position = pose.pose.pose.position
    by_transform = rig.transforms[-1][1]
    # The pose is that of the last update, up to 0.25 m of driving ago.
    assert math.dist((position.x, position.y), (rig.truth.x, rig.truth.y)) < 0.4
    assert pose_yaw(pose.pose.pose) == pytest.approx(by_transform.yaw + rig.robot.pose.yaw)
    covariance = pose.pose.covariance.reshape(6, 6)
    assert np.count_nonzero(covariance[[2, 3, 4]]) == 0
    assert np.all(np.linalg.eigvalsh(covariance[np.ix_([0, 1, 5], [0, 1, 5])]) > 0)


def test_cloud_bytes_are_the_particles(rig):
    rig.tell_initial_pose()
    rig.robot.run(1.0)
    data = rig.clouds[0]
    cloud = deserialize(data, CLOUD)
    count = len(cloud.particles)
    assert len(data) == 28 + 64 * count
    assert cloud.header.frame_id == "map"
    assert MIN_PARTICLES <= count <= MAX_PARTICLES
    expected = rig.amcl._filter.poses
    found = [(p.pose.position.x, p.pose.position.y, pose_yaw(p.pose)) for p in cloud.particles]
    assert np.array(found)[:, :2] == pytest.approx(expected[:, :2])
    turns = np.exp(1j * (np.array(found)[:, 2] - expected[:, 2]))
    assert turns == pytest.approx(np.ones(count))
    assert {p.weight for p in cloud.particles} == {1.0 / count}
