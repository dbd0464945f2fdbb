import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, message_class
from sim.fuzzing.relays import (
    ATTACKED_TOPIC,
    INPUT_TOPIC,
    FakeObject,
    FakeObjectRelay,
    NoiseRelay,
    Relay,
    ray_circle,
)
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import Executor
from sim.middleware.geometry import Pose2D, yaw_quaternion
from sim.middleware.node import Node
from sim.middleware.stamps import header

LaserScan = message_class("sensor_msgs/msg/LaserScan")
Odometry = message_class("nav_msgs/msg/Odometry")
PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
Pose = message_class("geometry_msgs/msg/Pose")
Point = message_class("geometry_msgs/msg/Point")
Quaternion = message_class("geometry_msgs/msg/Quaternion")

INCREMENT = 6.28 / 359
ranges = st.lists(
    st.floats(0.125, 20.0, width=32) | st.just(math.inf), min_size=360, max_size=360
).map(lambda values: np.array(values, np.float32))


def scan(values):
    no_intensities = np.zeros(360, np.float32)
    return LaserScan(
        header(0, "base_scan_tom"), 0.0, 6.28, INCREMENT, 0.0, 0.0, 0.12, 20.0, values,
        no_intensities,
    )  # fmt: skip


def odometry(x, y, yaw):
    pose = Pose(Point(x, y, 0.0), Quaternion(*yaw_quaternion(yaw)))
    message = object.__new__(Odometry)
    message.pose = PoseWithCovariance(pose, np.zeros(36))
    return message


def relayed(make, values, copies=1):
    """What a relay publishes, and the ground truth it writes."""
    domain = Domain(Executor())
    relay = make(domain)
    listener, heard, truth = Node(domain, "/listener"), [], []
    listener.create_subscription("sensor_msgs/msg/LaserScan", ATTACKED_TOPIC, heard.append)
    listener.create_subscription("oracle_msgs/msg/GroundTruth", GROUND_TRUTH_TOPIC, truth.append)
    tom = Node(domain, "/tom").create_publisher(
        "sensor_msgs/msg/LaserScan", INPUT_TOPIC, qos.SENSOR_DATA
    )
    if isinstance(relay, FakeObjectRelay):
        relay.on_odometry(odometry(0.0, 0.0, 0.0))
    for _ in range(copies):
        tom.publish(scan(values))
    domain.executor.run_until(1)
    return heard, truth


def noise(level, seed=1):
    return lambda domain: NoiseRelay(
        domain, level=level, seed=seed, with_odometry=False, latency_ns=0
    )


@given(ranges)
def test_passthrough_hands_on_the_very_same_ranges(values):
    (heard,), (truth,) = relayed(
        lambda domain: Relay(domain, with_odometry=True, latency_ns=0), values
    )
    np.testing.assert_array_equal(heard.ranges, values)
    assert truth.magnitude == 0.0


@given(ranges, st.floats(0.0, 0.5))
def test_noise_stays_within_its_level_and_leaves_missing_returns_alone(values, level):
    (heard,), _ = relayed(noise(level), values)
    finite = np.isfinite(values)
    np.testing.assert_array_equal(np.isfinite(heard.ranges), finite)
    change = np.abs(heard.ranges[finite] - values[finite])
    assert (change <= level * values[finite] + 1e-5).all()
    assert (heard.ranges[finite] >= np.float32(0.12)).all()
    assert (heard.ranges[finite] <= 20.0).all()


def test_noise_of_a_scan_depends_on_the_seed_and_its_number_only():
    values = np.full(360, 2.0, np.float32)
    once, _ = relayed(noise(0.1, seed=7), values, copies=2)
    again, _ = relayed(noise(0.1, seed=7), values, copies=2)
    other, _ = relayed(noise(0.1, seed=8), values, copies=1)
    np.testing.assert_array_equal(once[1].ranges, again[1].ranges)
    assert not np.array_equal(once[0].ranges, once[1].ranges)
    assert not np.array_equal(once[0].ranges, other[0].ranges)


@given(ranges, st.floats(0.6, 5.0), st.floats(-math.pi, math.pi), st.floats(0.05, 0.5))
def test_a_fake_object_only_ever_shortens_rays_to_its_own_surface(
    values, distance, bearing, radius
):
    target = FakeObject(distance * math.cos(bearing), distance * math.sin(bearing), radius)
    (heard,), (truth,) = relayed(
        lambda domain: FakeObjectRelay(domain, target=target, mount=Pose2D(), latency_ns=0), values
    )
    changed = heard.ranges != values
    assert (heard.ranges[changed] < values[changed]).all()
    bearings = INCREMENT * np.flatnonzero(changed)
    x, y = heard.ranges[changed] * np.cos(bearings), heard.ranges[changed] * np.sin(bearings)
    surface = np.hypot(x - target.x, y - target.y)
    np.testing.assert_allclose(surface, radius, atol=1e-4)
    assert truth.detail == f"{changed.sum()} of 360 ranges"


@given(st.floats(0.3, 5.0), st.floats(-math.pi, math.pi), st.floats(0.05, 0.25))
def test_ray_circle_meets_the_circle_head_on_at_distance_less_radius(distance, bearing, radius):
    sensor = Pose2D(1.0, -2.0, 0.7)
    direction = sensor.yaw + bearing
    target = FakeObject(
        sensor.x + distance * math.cos(direction), sensor.y + distance * math.sin(direction), radius
    )
    ahead, behind = ray_circle(np.array([bearing, bearing + math.pi]), sensor, target)
    assert ahead == pytest.approx(distance - radius, abs=1e-9)
    assert behind == math.inf


def test_a_sensor_inside_the_fake_object_sees_nothing_of_it():
    hits = ray_circle(np.linspace(0, 6, 10), Pose2D(), FakeObject(0.1, 0.0, 0.2))
    assert np.isinf(hits).all()
