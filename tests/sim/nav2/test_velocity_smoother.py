import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.node import Node
from sim.nav2.messages import TWIST, twist_message
from sim.nav2.velocity_smoother import ANGULAR, LINEAR, VelocitySmoother, smooth

speeds = st.floats(-3.0, 3.0)


@given(current=st.floats(-0.26, 0.26), command=speeds)
def test_a_step_stays_within_speed_and_acceleration_limits_and_never_overshoots(current, command):
    after = smooth(current, command, LINEAR)
    target = min(max(command, -0.26), 0.26)
    assert abs(after) <= 0.26 + 1e-12
    assert abs(after - current) <= 2.5 / 20 + 1e-12
    assert min(current, target) - 1e-12 <= after <= max(current, target) + 1e-12


@pytest.mark.parametrize(
    ("current", "command", "expected"),
    [
        (0.0, 0.26, 0.125),  # 2.5 m/s^2 for 50 ms
        (0.125, 0.26, 0.25),
        (0.25, 0.26, 0.26),
        (0.26, 0.0, 0.135),
        (0.05, -0.26, -0.075),  # through zero: bounded by the deceleration
        (0.2, 1.0, 0.26),
    ],
)
def test_linear_steps_of_a_known_example(current, command, expected):
    assert smooth(current, command, LINEAR) == pytest.approx(expected)


def test_turning_speeds_up_by_3_2_rad_per_square_second():
    assert smooth(0.0, 1.0, ANGULAR) == pytest.approx(0.16)


@pytest.fixture
def rig():
    """A smoother, a way to command it, and what it sent: (time, linear, angular)."""
    domain = Domain(Executor())
    node = Node(domain, "/test")
    commands = node.create_publisher(TWIST, "/cmd_vel_nav")
    sent = []
    smoother = VelocitySmoother(domain)
    smoother.configure()
    smoother.activate()
    node.create_subscription(
        TWIST, "/cmd_vel_raw", lambda m: sent.append((node.now_ns, m.linear.x, m.angular.z))
    )
    return domain, commands, sent


def test_nothing_is_sent_before_the_first_command(rig):
    domain, _, sent = rig
    domain.executor.run_until(SECOND)
    assert sent == []


def test_without_commands_the_last_is_held_for_a_second_and_then_ramped_down(rig):
    domain, commands, sent = rig
    commands.publish(twist_message(0.26, 0.0))
    domain.executor.run_until(3 * SECOND)
    times = [t for t, *_ in sent]
    assert times == [50 * MILLISECOND * (i + 1) for i in range(len(times))]
    held = [v for t, v, _ in sent if t <= SECOND]
    assert held[:3] == pytest.approx([0.125, 0.25, 0.26])
    assert set(held[2:]) == {0.26}
    ramp = [v for t, v, _ in sent if t > SECOND]
    assert ramp == pytest.approx([0.135, 0.01, 0.0])


def test_a_halt_is_repeated_until_the_timeout(rig):
    domain, commands, sent = rig
    commands.publish(twist_message(0.0, 0.0))
    domain.executor.run_until(3 * SECOND)
    assert [t for t, *_ in sent] == [50 * MILLISECOND * (i + 1) for i in range(20)]
    assert {v for _, v, _ in sent} == {0.0}
