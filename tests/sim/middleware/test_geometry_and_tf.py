import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.geometry import Pose2D, quaternion_yaw, wrap_angle, yaw_quaternion
from sim.middleware.node import Node
from sim.middleware.tf import (
    CACHE_NS,
    TransformBroadcaster,
    TransformBuffer,
    TransformError,
    TransformListener,
    planar_transform,
)

_TFMessage = message_class("tf2_msgs/msg/TFMessage")

coordinates = st.floats(-100, 100)
angles = st.floats(-math.pi, math.pi, exclude_max=True)
poses = st.builds(Pose2D, coordinates, coordinates, angles)


def close(a: Pose2D, b: Pose2D) -> bool:
    same_place = math.hypot(a.x - b.x, a.y - b.y) < 1e-9
    return same_place and abs(wrap_angle(a.yaw - b.yaw)) < 1e-9


@given(poses)
def test_a_pose_composed_with_its_inverse_is_the_origin(pose):
    assert close(pose.compose(pose.inverse()), Pose2D())
    assert close(pose.inverse().compose(pose), Pose2D())


@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    assert close(a.compose(b).compose(c), a.compose(b.compose(c)))


@given(poses, coordinates, coordinates)
def test_points_move_as_poses_do(pose, x, y):
    (moved,) = pose.apply(np.array([[x, y]]))
    expected = pose.compose(Pose2D(x, y))
    assert moved == pytest.approx((expected.x, expected.y), abs=1e-9)


@given(angles)
def test_yaw_survives_the_quaternion(yaw):
    assert quaternion_yaw(*yaw_quaternion(yaw)) == pytest.approx(yaw, abs=1e-9)


def heard(*transforms):
    domain = Domain(Executor())
    node = Node(domain, "/node")
    listener = TransformListener(domain, "0")
    TransformBroadcaster(node).send(list(transforms))
    domain.executor.run_until(0)
    return listener.buffer


@given(poses, poses)
def test_lookup_goes_up_and_down_the_tree(odom_in_map, base_in_odom):
    buffer = heard(
        planar_transform(0, "map", "odom", odom_in_map),
        planar_transform(0, "odom", "base_link", base_in_odom),
    )
    expected = odom_in_map.compose(base_in_odom)
    assert close(buffer.lookup("map", "base_link"), expected)
    assert close(buffer.lookup("base_link", "map"), expected.inverse())


@given(st.floats(0, 1), st.floats(3.0, 3.28))
def test_between_two_stamps_a_transform_is_interpolated_the_short_way_round(share, yaw):
    buffer = heard(
        planar_transform(0, "odom", "base_link", Pose2D(0.0, 0.0, 3.0)),
        planar_transform(SECOND, "odom", "base_link", Pose2D(1.0, 2.0, wrap_angle(yaw))),
    )
    time_ns = int(share * SECOND)
    share = time_ns / SECOND
    expected = Pose2D(share, 2 * share, wrap_angle(3.0 + share * (yaw - 3.0)))
    found = buffer.lookup("odom", "base_link", time_ns)
    assert math.hypot(found.x - expected.x, found.y - expected.y) < 1e-8
    assert abs(wrap_angle(found.yaw - expected.yaw)) < 1e-8


@pytest.mark.parametrize("time_ns", [-1, SECOND + 1])
def test_outside_the_known_span_there_is_no_transform(time_ns):
    buffer = heard(
        planar_transform(0, "odom", "base_link", Pose2D()),
        planar_transform(SECOND, "odom", "base_link", Pose2D()),
    )
    with pytest.raises(TransformError, match="known from 0.000 s to 1.000 s"):
        buffer.lookup("odom", "base_link", time_ns)


def test_unconnected_frames_have_no_transform():
    buffer = heard(planar_transform(0, "odom", "base_link", Pose2D()))
    with pytest.raises(TransformError, match="map and base_link are not connected"):
        buffer.lookup("map", "base_link")


@given(st.tuples(poses, poses, poses))
def test_the_compiled_lookup_computes_as_poses_do_to_the_bit(links):
    chain = [planar_transform(0, f"{i}", f"{i + 1}", pose) for i, pose in enumerate(links)]
    root = below = Pose2D()
    for pose in reversed(links):
        sent = Pose2D(pose.x, pose.y, quaternion_yaw(*yaw_quaternion(pose.yaw)))
        below = sent.compose(below)
    assert heard(*chain).lookup("0", "3") == root.inverse().compose(below)


def test_frames_in_a_circle_have_no_transform():
    buffer = heard(
        planar_transform(0, "odom", "base_link", Pose2D()),
        planar_transform(0, "base_link", "odom", Pose2D()),
    )
    with pytest.raises(TransformError, match="odom and base_link are not connected"):
        buffer.lookup("odom", "base_link")


def test_a_buffer_keeps_all_frames_and_the_last_ten_seconds_of_each():
    frames, samples, period_ns = 50, 3000, 4_000_000
    chain = [planar_transform(0, f"{i}", f"{i + 1}", Pose2D(1.0)) for i in range(frames)]
    moving = [planar_transform(i * period_ns, "50", "51", Pose2D(i)) for i in range(samples)]
    buffer = TransformBuffer()
    buffer.receive(_TFMessage(chain), static=True)
    buffer.receive(_TFMessage(moving), static=False)
    newest_ns = (samples - 1) * period_ns
    oldest_ns = newest_ns - CACHE_NS + period_ns
    assert buffer.lookup("0", "51", oldest_ns).x == frames + oldest_ns // period_ns
    with pytest.raises(TransformError, match="not at 0.000 s"):
        buffer.lookup("0", "51", 0)
