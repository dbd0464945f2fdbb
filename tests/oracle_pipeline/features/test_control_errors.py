"""Control errors: what follows a command is compared with it, whatever a robot calls the two."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.api import learn, score
from oracle_pipeline.datasets import LAG, MINUS
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.signals.collector import Signals
from oracle_pipeline.features.signals.control_errors import MOST_FOLLOWERS, control_errors
from oracle_pipeline.features.signals.statistics import SignalTable
from oracle_pipeline.scoring.comparable import given_numbers

COUNT = 200
TIMES_NS = np.arange(COUNT) * 50_000_000
SPAN = Span(0, 10_000_000_000)


def signal(topic, name, unit="", values=None):
    values = np.zeros(COUNT) if values is None else values
    return Signals(topic, (name,), (unit,), TIMES_NS[: len(values)], values[:, np.newaxis])


def named(signals):
    return {
        f"{errors.topic} {errors.names[0]}"
        for errors, _ in control_errors([(each, np.zeros(1)) for each in signals])
    }


@pytest.mark.parametrize(
    ("command", "follower"),
    [
        (("/cmd_vel", "linear.x"), ("/odom", "twist.twist.linear.x")),  # a mobile base
        (("/action", "kElbow"), ("/observation/state", "kElbow")),  # LeRobot
        (("/actions", "left_joint_1_pos"), ("/state", "left_joint_1_pos")),
        (("/servo", "target_position"), ("/servo", "present_position")),
        (("/controller", "desired.positions[0]"), ("/controller", "actual.positions[0]")),
        (("/controller", "reference.positions[0]"), ("/controller", "feedback.positions[0]")),
        (("/joint_commands", "position.elbow"), ("/joint_states", "position.elbow")),
        (("/ATT", "DesRoll"), ("/ATT", "Roll")),  # ArduPilot
        (("/PIDR", "Tar"), ("/PIDR", "Act")),
        (("/local_position_setpoint", "x"), ("/local_position", "x")),  # PX4
        (("/mavros/nav_info/roll", "commanded"), ("/mavros/nav_info/roll", "measured")),
        (("/log", "controller_cmd_roll"), ("/log", "controller_roll")),  # Crazyflie
        (("/lowcmd", "motor_cmd[3].q"), ("/lowstate", "motor_state[3].q")),  # Unitree
        (("/franka_state", "q_d[0]"), ("/franka_state", "q[0]")),
        (
            ("/master_left/joint_states", "position.waist"),
            ("/puppet_left/joint_states", "position.waist"),
        ),  # ALOHA
        (
            ("/control_cmd", "lateral.steering_tire_angle"),
            ("/steering_status", "steering_tire_angle"),
        ),  # Autoware
        (("/control_cmd", "longitudinal.velocity"), ("/velocity", "longitudinal_velocity")),
    ],
)
def test_what_follows_a_command_is_known_by_its_name(command, follower):
    (topic, field), (of_command, set_point) = follower, command
    told = f"{of_command.strip('/').replace('/', '.')}.{set_point}"
    assert named([signal(*command), signal(*follower)]) == {f"{topic} {field}{MINUS}{told}"}


@pytest.mark.parametrize(
    "others",
    [
        [("/cmd_vel_nav", "linear.x", "m/s")],  # a command, too
        [("/imu", "linear.x", "m/s^2")],  # another quantity
        [("/odom", "angular.x", "m/s")],
        [("/controller", "error.linear.x", "m/s")],  # has its command in it
        [(f"/wheel{number}", "linear.x", "m/s") for number in range(MOST_FOLLOWERS + 1)],
    ],
)
def test_other_numbers_do_not_follow(others):
    assert not named([signal("/cmd_vel", "linear.x", "m/s"), *(signal(*each) for each in others)])


def test_a_topic_with_a_like_name_follows_alone():
    names = ("/gyro", "/position", "/position_setpoint")
    assert named([signal(name, "x") for name in names]) == {
        f"/position x{MINUS}position_setpoint.x"
    }


@given(st.integers(0, 1000), st.floats(-5.0, 5.0), st.integers(1, 20))
def test_the_error_is_that_of_the_last_command(seed, offset, every):
    told = np.random.default_rng(seed).normal(size=COUNT)[::every]
    commands = Signals("/command", ("x",), ("",), TIMES_NS[::every], told[:, np.newaxis])
    follower = signal("/state", "x", values=np.repeat(told, every)[:COUNT] + offset)
    found = SignalTable([commands, follower]).values(SPAN)
    assert found[f"signals./state/x{MINUS}command.x.mean"] == pytest.approx(offset)
    assert found[f"signals./state/x{MINUS}command.x.std"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("offset", [7.0, -30.0, 353.0])
def test_errors_of_angles_stay_in_their_unit_and_within_half_a_turn(offset):
    told = np.linspace(100.0, 300.0, COUNT)
    wrapped = (told + offset + 180.0) % 360.0 - 180.0
    both = [signal("/target", "yaw", values=told), signal("/state", "yaw", values=wrapped)]
    error = SignalTable(both).values(SPAN)[f"signals./state/yaw{MINUS}target.yaw.mean"]
    assert error == pytest.approx((offset + 180.0) % 360.0 - 180.0)


@given(st.integers(0, 1000), st.integers(0, 4), st.floats(-5.0, 5.0))
def test_the_lag_is_that_of_a_copy_that_comes_late(seed, late, offset):
    told = np.cumsum(np.cumsum(np.random.default_rng(seed).normal(size=COUNT + late)))
    both = [signal("/command", "x", values=told[late:]),
            signal("/state", "x", values=told[:COUNT] + offset)]  # fmt: skip
    lag = SignalTable(both).values(SPAN)[f"signals./state/x{MINUS}command.x{LAG}.mean"]
    assert lag == pytest.approx(0.05 * late, rel=0.3, abs=1e-6)


@given(st.integers(0, 1000), st.floats(-100.0, 100.0))
def test_there_is_no_lag_behind_a_command_that_stands_still(seed, value):
    rng = np.random.default_rng(seed)
    # Rates have rounding errors if times are not even.
    times_ns = np.cumsum(rng.integers(30_000_000, 70_000_000, COUNT))
    told, own = np.full((COUNT, 1), value), value + rng.normal(size=(COUNT, 1))
    table = SignalTable([
        Signals("/command", ("x",), ("",), times_ns, told),
        Signals("/state", ("x",), ("",), times_ns, own),
    ])  # fmt: skip
    assert not any(LAG in column for column in table.values(SPAN))


def test_a_command_that_never_came_before_gives_no_error():
    early = signal("/state", "x", values=np.zeros(10))
    late = Signals("/command", ("x",), ("",), TIMES_NS[50:60], np.zeros((10, 1)))
    assert not control_errors([(each, np.zeros(1)) for each in (early, late)])


def test_an_error_is_no_number_of_a_message():
    of_messages = "signals./state/x.missing"
    columns = [of_messages, f"signals./state/x{MINUS}command.x.missing"]
    found = given_numbers(pd.DataFrame([[0.0, 0.0]], columns=columns))
    assert list(found.columns) == [of_messages.removesuffix(".missing")]


def task(path, rng, *, offset=0.0):
    """Write how an arm follows a task of its own, with an encoder that is off."""
    columns = {"time": TIMES_NS * 1e-9}
    for joint in range(3):
        told = rng.normal() + np.cumsum(rng.normal(scale=0.05, size=COUNT))
        late = np.concatenate([np.full(2, told[0]), told[:-2]])
        measured = late + rng.normal(scale=0.01, size=COUNT) + (offset if joint == 1 else 0.0)
        columns |= {f"joint{joint}_desired": told, f"joint{joint}_actual": measured}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


@pytest.mark.slow(8)
def test_an_offset_far_below_the_differences_between_tasks_is_found(tmp_path):
    rng = np.random.default_rng(3)
    card = learn([task(tmp_path / f"{number}.csv", rng) for number in range(20)])
    tried = [task(tmp_path / f"n{number}.csv", rng) for number in range(3)]
    tried += [task(tmp_path / f"o{number}.csv", rng, offset=0.1) for number in range(3)]
    verdicts = score(tried, card)
    assert [verdict.outcome for verdict in verdicts] == ["normal"] * 3 + ["anomalous"] * 3
    assert f"joint1_actual{MINUS}log.joint1_desired" in verdicts[-1].evidence[0].feature
