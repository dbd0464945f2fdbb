"""Rate errors: a rate in a message is compared with how fast the number beside it changes."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.api import learn, score
from oracle_pipeline.bags.types import message_class
from oracle_pipeline.datasets import MINUS
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.signals.collector import Signals
from oracle_pipeline.features.signals.rate_errors import rate_errors
from oracle_pipeline.features.signals.statistics import SignalTable
from oracle_pipeline.opened_run import open_run

COUNT = 400
HZ = 50
TIMES_S = np.arange(COUNT) / HZ
SPAN = Span(0, 10_000_000_000)


def signals(*names, values=None, times_s=TIMES_S, adjacent=None):
    values = np.zeros((COUNT, len(names))) if values is None else np.column_stack(values)
    times_ns = np.round(times_s * 1e9).astype(np.int64)
    return Signals("/topic", names, ("",) * len(names), times_ns, values, adjacent)


def named(*names):
    return {errors.names[0] for errors in rate_errors([signals(*names)])}


@pytest.mark.parametrize(
    ("rate", "level"),
    [
        ("velocity[elbow]", "position[elbow]"),  # JointState
        ("actual.velocities[0]", "actual.positions[0]"),
        ("angular_velocity.z", "orientation.yaw"),  # Imu
        ("twist.twist.angular.x", "pose.pose.orientation.roll"),  # Odometry
        ("vx", "x"),  # PX4, MAVLink
        ("stateEstimate.vz", "stateEstimate.z"),  # Crazyflie
        ("rollspeed", "roll"),  # MAVLink
        ("controller_yawRate", "controller_yaw"),
        ("actual_qd_3", "actual_q_3"),  # Universal Robots
        ("joint_velocities[2]", "joint_positions[2]"),
        ("motor_a.speed", "motor_a.angle"),
        ("ax", "vx"),
        ("accelerations[1]", "velocities[1]"),
    ],
)
def test_a_rate_is_known_by_its_name(rate, level):
    assert named(level, rate) == {f"{rate}{MINUS}rate of {level}"}


@pytest.mark.parametrize(
    "names",
    [
        ("position[0]", "velocity[1]"),  # of another joint
        ("reference.positions[0]", "feedback.velocities[0]"),
        ("position[0]", "acceleration[0]"),  # not the rate of it, but of that
        ("pose.pose.position.x", "twist.twist.linear.x"),  # in another frame
        ("count", "count.rate"),  # computed from it
        ("pos.x", "position.x", "velocity.x"),  # either might be meant
        ("angular_velocity.x", "linear_acceleration.x", "orientation.yaw"),
    ],
)
def test_other_numbers_are_no_rate(names):
    assert not named(*names)


@given(st.integers(0, 1000), st.floats(-5.0, 5.0), st.floats(0.0, 0.4))
def test_the_error_is_what_the_rate_tells_too_much(seed, offset, jitter):
    rng = np.random.default_rng(seed)
    times_s = TIMES_S + rng.uniform(-jitter, jitter, COUNT) / HZ
    phase, speed = rng.uniform(0.0, 6.0), rng.uniform(0.1, 2.0)
    level = np.sin(phase + speed * times_s)
    rate = speed * np.cos(phase + speed * times_s) + offset
    both = signals("position", "velocity", values=(level, rate), times_s=times_s - times_s[0])
    found = SignalTable([both]).values(SPAN)
    error = f"signals./topic/velocity{MINUS}rate of position"
    assert found[f"{error}.mean"] == pytest.approx(offset, abs=2e-3)
    assert found[f"{error}.std"] == pytest.approx(0.0, abs=2e-3)


def test_an_angle_that_wraps_turns_on():
    turned = 3.0 * TIMES_S
    wrapped = (turned + np.pi) % (2.0 * np.pi) - np.pi
    both = signals("yaw", "yaw_rate", values=(wrapped, np.full(COUNT, 3.0)))
    found = SignalTable([both]).values(SPAN)
    assert found[f"signals./topic/yaw_rate{MINUS}rate of yaw.max"] == pytest.approx(0.0, abs=1e-9)


def test_numbers_that_are_missing_or_come_at_once_leave_finite_errors():
    rng = np.random.default_rng(3)
    level, rate = np.sin(TIMES_S), np.cos(TIMES_S)
    level[rng.random(COUNT) < 0.2] = np.nan
    rate[rng.random(COUNT) < 0.2] = np.inf
    times_s = np.round(TIMES_S, 1)  # five messages at a time
    both = signals("x", "vx", values=(level, rate), times_s=times_s)
    for errors in rate_errors([both]):
        assert len(errors.values) == len(errors.times_ns)
        assert np.isfinite(errors.values).all()


def test_the_stamps_count_of_messages_that_a_loaded_machine_records_late(bag_of):
    make = message_class("sensor_msgs/msg/JointState")
    late_s = np.random.default_rng(5).exponential(5e-3, COUNT)

    def joints(time_s):
        stamp = message_class("builtin_interfaces/msg/Time")(0, int(time_s * 1e9) % 10**9)
        stamp.sec = int(time_s)
        header = message_class("std_msgs/msg/Header")(stamp, "")
        return make(header, ["elbow"], np.sin([time_s]), np.cos([time_s]), np.zeros(0))

    times = zip(TIMES_S.tolist(), (TIMES_S + late_s).tolist(), strict=True)
    bag = bag_of([(late, "/joint_states", joints(time_s)) for time_s, late in times])
    with open_run(bag) as run:
        found = extract(run, build_manager()).run.iloc[0]
    error = f"signals./joint_states/velocity[elbow]{MINUS}rate of position[elbow]"
    assert found[f"{error}.std"] == pytest.approx(0.0, abs=1e-3)


def test_where_messages_were_passed_over_there_is_no_error():
    passed_over = signals("x", "vx", adjacent=np.arange(COUNT) % 2 == 1)
    assert not rate_errors([passed_over])


def recorded(seed, fault=""):
    """Return 20 s of two joints that move at random; from a third on, the first has a fault."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(0.0, 20.0, 1.0 / HZ)
    size, speed, phase = (rng.uniform(low, high, (3, 2)) for low, high in
                          ((0.1, 0.6), (0.5, 4.0), (0.0, 6.0)))  # fmt: skip
    turns = phase + speed * times_s[:, np.newaxis, np.newaxis]
    position = (size * np.sin(turns)).sum(axis=1) + rng.normal(0.0, 1e-3, (len(times_s), 2))
    velocity = (size * speed * np.cos(turns)).sum(axis=1)
    velocity += rng.normal(0.0, 1e-2, velocity.shape)
    late = times_s > times_s[-1] / 3.0
    if fault == "offset":
        position[late, 0] += 0.1
    elif fault == "noise":
        position[late, 0] += rng.normal(0.0, 0.02, late.sum())
    elif fault == "scale":
        velocity[late, 0] *= 1.15
    elif fault == "frozen":
        held = late & (times_s % 5.0 < 0.5)
        position[held, 0] = position[np.argmax(held), 0]
    joints = [f"{what}[{n}]" for what in ("position", "velocity") for n in (0, 1)]
    table = pd.DataFrame(np.hstack([position, velocity]), columns=joints)
    table.insert(0, "time", times_s)
    return table


@pytest.mark.slow(10)
def test_faults_of_a_sensor_are_found_whatever_the_robot_does(tmp_path):
    def write(name, seed, fault=""):
        recorded(seed, fault).to_csv(tmp_path / f"{name}.csv", index=False)
        return tmp_path / f"{name}.csv"

    card = learn([write(f"good_{seed}", seed) for seed in range(30)])
    faults = ["", "", "", "offset", "noise", "scale", "frozen"]
    tried = [write(f"tried_{n}", 100 + n, fault) for n, fault in enumerate(faults)]
    verdicts = score(tried, card)
    assert [verdict.outcome for verdict in verdicts] == ["normal"] * 3 + ["anomalous"] * 4
    assert f"velocity[0]{MINUS}rate of position[0]" in verdicts[-1].evidence[0].feature
