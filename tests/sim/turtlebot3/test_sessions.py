"""The values that a session draws, each of which has an effect."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.middleware.delays import TIME_SLICE_MS, Delays, Load
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.turtlebot3.arena import HEXAGON
from sim.turtlebot3.map import FREE, OCCUPIED, UNKNOWN, occupancy_map
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.sensors import SCAN_RANGE_MAX_M, GyroError, ImuPlugin, LidarNoise, noisy_ranges
from sim.turtlebot3.sessions import draw_session, estimated_start, mapped, sensor_errors
from sim.turtlebot3.world import World


@given(
    st.floats(0.0, 5.0), st.floats(0.0, 1.0), st.integers(0, 2**32),
    st.lists(st.integers(0, 20 * MILLISECOND), min_size=1, max_size=40),
)  # fmt: skip
@settings(max_examples=30)
def test_messages_arrive_in_order_and_never_before_the_latency(jitter, processor, seed, gaps):
    delays = Delays(Load(jitter, processor), np.random.default_rng(seed))
    sent = np.cumsum(gaps).tolist()
    due = [delays.due_ns(time, 3 * MILLISECOND) for time in sent]
    assert due == sorted(due)
    assert all(a - b >= 3 * MILLISECOND for a, b in zip(due, sent, strict=True))
    again = Delays(Load(jitter, processor), np.random.default_rng(seed))
    assert [again.due_ns(time, 3 * MILLISECOND) for time in sent] == due


def test_delays_have_the_mean_that_jitter_and_load_say():
    delays = Delays(Load(1.5, 0.2), np.random.default_rng(0))
    times = range(0, 20_000 * SECOND, SECOND)  # so rare that none waits for the one before
    later_ms = [(delays.due_ns(time, 0) - time) / MILLISECOND for time in times]
    assert np.mean(later_ms) == pytest.approx(1.5 + 0.2 * TIME_SLICE_MS / 2, rel=0.03)
    still = Delays(Load(), np.random.default_rng(0))
    assert [still.due_ns(time, 7) for time in (1, 2, 30)] == [8, 9, 37]


def test_a_session_has_two_lidars_with_independent_errors():
    errors = sensor_errors(draw_session(0, 0))
    assert errors.scan.bias_m != errors.scan_tom.bias_m
    assert errors.scan.sd_m == errors.scan_tom.sd_m


def test_dropouts_are_rays_without_a_return():
    ranges = noisy_ranges(np.full(50_000, 2.0), LidarNoise(dropouts=0.01), np.random.default_rng(0))
    assert np.isinf(ranges).mean() == pytest.approx(0.01, rel=0.2)
    assert (ranges[np.isinf(ranges)] > SCAN_RANGE_MAX_M).all()


def test_a_map_errs_at_walls_only_and_is_the_same_all_session():
    world, session = occupancy_map(HEXAGON), replace(draw_session(0, 3), map_errors=0.3)
    drawn = mapped(world, 0, session)
    wrong = drawn.data != world.data
    walls = world.data == OCCUPIED
    assert (drawn.data[wrong & walls] == FREE).all()
    assert (world.data[wrong & ~walls] == FREE).all()
    assert ((world.data == UNKNOWN) == (drawn.data == UNKNOWN)).all()
    assert wrong[walls].mean() == pytest.approx(0.3, rel=0.2)
    rows, columns = np.nonzero(wrong & ~walls)
    beside = [walls[rows + i, columns + j] for i, j in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    assert np.any(beside, axis=0).all()
    np.testing.assert_array_equal(mapped(world, 0, session).data, drawn.data)
    assert (mapped(world, 0, draw_session(0, 4)).data != drawn.data).any()


def test_the_initial_pose_has_the_error_of_the_session():
    session = draw_session(0, 0)
    rng = np.random.default_rng(0)
    starts = [estimated_start(Pose2D(1.0, 2.0, 0.5), session, rng) for _ in range(4000)]
    errors = np.array([(pose.x - 1.0, pose.y - 2.0, pose.yaw - 0.5) for pose in starts])
    sd = (session.start_sd_m, session.start_sd_m, session.start_sd_rad)
    np.testing.assert_allclose(errors.std(axis=0), sd, rtol=0.05)


def test_a_larger_wheel_goes_further_and_two_that_differ_turn():
    def speeds(left, right):
        world = World(WorldParameters(Pose2D(-2.0, -0.5), wheels=(left, right)))
        world.command_wheels(6.0, 6.0)
        world.advance_to(4 * SECOND)
        return world.twist

    (forward, turning), (faster, straight) = speeds(1.0, 1.0), speeds(1.01, 1.01)
    assert faster / forward == pytest.approx(1.01, abs=0.001)
    assert straight == pytest.approx(turning, abs=1e-6)
    _, to_the_left = speeds(1.0, 1.01)
    assert to_the_left == pytest.approx(0.01 * forward / 0.288, rel=0.15)


def test_a_gyroscope_errs_by_its_scale_and_about_the_vertical_axis_by_its_bias():
    def turning(gyro):
        world = World(WorldParameters(Pose2D(-2.0, -0.5)))
        executor = Executor(world.advance_to)
        domain = Domain(executor)
        heard = []
        ImuPlugin(domain, world.imu, gyro, np.random.default_rng(0))
        Node(domain, "/tester").create_subscription("sensor_msgs/msg/Imu", "/imu", heard.append)
        world.command_wheels(-3.0, 3.0)
        executor.run_until(3 * SECOND)
        return np.array([(m.angular_velocity.x, m.angular_velocity.z) for m in heard[-100:]])

    exact, wrong = turning(GyroError()), turning(GyroError(bias_rad_s=0.01, scale=1.02))
    np.testing.assert_allclose(wrong[:, 1].mean(), 1.02 * exact[:, 1].mean() + 0.01, atol=1e-4)
    np.testing.assert_allclose(wrong[:, 0].mean(), exact[:, 0].mean(), atol=1e-4)
