"""Effects of the built-in scenarios of the first testbed on messages."""

import inspect
import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fuzzing.execution import execute
from sim.fuzzing.random import Draws
from sim.turtlebot3 import frames
from tests.sim.fuzzing.workbench import (
    BUILTINS,
    INCREMENT,
    SCAN,
    builtin,
    data,
    examples,
    odometry,
    only,
    ranges,
    results,
    scan,
    scans,
    stamp,
    start,
)

PASSTHROUGHS = [
    name
    for name in BUILTINS
    if builtin(name).type.name == SCAN and builtin(name).scenario.control == "passthrough"
]


class Replayed(random.Random):
    """Python's generator, but its draws are given."""

    def __init__(self, draws):
        super().__init__()
        self._draws = iter(draws)

    def random(self):
        return float(next(self._draws))


def noise_number(compiled):
    ((noise,),) = [action.do for action in compiled.actions]
    return inspect.getclosurevars(noise.apply).nonlocals["number"]


# The thesis's modes.


@pytest.mark.parametrize("name", PASSTHROUGHS)
@given(ranges)
def test_passthrough_forwards_the_same_object(name, values):
    message = scan(0, values)
    (result,) = results(builtin(name), [message])
    ((due_ns, output, _),) = result.outputs
    assert due_ns == stamp(0)
    assert output is message
    assert (result.truth.operation, result.truth.magnitude) == ("passthrough", 0.0)


@given(ranges, st.floats(0.0, 1.0), st.integers(0, 1000))
def test_random_noise_thesis_is_the_formula_of_the_thesis(values, level, number):
    compiled = builtin("random_noise_thesis")
    message = scan(number, values)
    heard = only(compiled, message, level=level)
    draws = Draws(1, compiled.scenario.seed).generator(stamp(number), noise_number(compiled))
    generator = Replayed(draws.random(len(values)))
    with np.errstate(over="ignore"):
        expected = [
            np.float32(value + generator.uniform(-level * value, level * value))
            for value in values.tolist()
        ]
    np.testing.assert_array_equal(heard.ranges, np.array(expected))
    assert heard.ranges.dtype == np.float32
    assert data(replace(heard, ranges=values)) == data(message)


@given(ranges, st.floats(0.0, 0.5))
def test_random_noise_keeps_to_its_level_and_the_limits_and_spares_missing_returns(values, level):
    heard = only(builtin("random_noise"), scan(0, values), level=level).ranges
    finite = np.isfinite(values)
    np.testing.assert_array_equal(heard[~finite], values[~finite])
    limits = np.float32(0.12), np.float32(20.0)
    low = np.clip(values[finite] * (1 - level) - 1e-5, *limits)
    high = np.clip(values[finite] * (1 + level) + 1e-5, *limits)
    assert ((heard[finite] >= low) & (heard[finite] <= high)).all()


def test_the_truth_of_noise_has_the_number_of_ranges_and_the_size():
    compiled = builtin("random_noise")
    values = np.full(360, 2.0, np.float32)
    values[:60] = np.inf
    (result,) = results(compiled, [scan(0, values)])
    change = np.abs(result.outputs[0].message.ranges[60:] - values[60:])
    assert result.truth.operation == "random_noise"
    assert result.truth.magnitude == pytest.approx(change.max())
    assert result.truth.detail == f"{np.count_nonzero(change)} of 360 ranges"
    assert (result.truth.stamp_ns, result.truth.topic) == (stamp(0), "/scan_fakeobject")


def ray_disc(origin, direction, centre, radius):
    """First meeting of a ray with a disc, from the roots of its quadratic; inf without one."""
    dx, dy = origin[0] - centre[0], origin[1] - centre[1]
    half_b = dx * math.cos(direction) + dy * math.sin(direction)
    c = dx * dx + dy * dy - radius * radius
    if c <= 0.0 or half_b * half_b < c or half_b > 0.0:
        return math.inf
    return -half_b - math.sqrt(half_b * half_b - c)


@given(
    ranges,
    st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-math.pi, math.pi)),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    st.floats(0.05, 0.5),
)
def test_fake_object_is_a_disc_in_the_odometry_frame(values, pose, centre, radius):
    compiled = builtin("fake_object")
    execution = execute(compiled, 1, {"x": centre[0], "y": centre[1], "radius": radius})
    execution.on_source("odom", odometry(0, *pose), stamp(0))
    message = scan(1, values)
    ((_, heard, _),) = execution.on_message(message, stamp(1), 0.2).outputs
    x, y, yaw = pose
    ahead, left, _ = frames.BASE_SCAN_TOM.xyz
    assert left == 0.0
    origin = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
    nearest, farthest, increment = np.float32([0.12, 20.0, INCREMENT]).astype(float)
    distance = math.dist(origin, centre)
    for i, (old, new) in enumerate(zip(values.tolist(), heard.ranges.tolist(), strict=True)):
        bearing = yaw + i * increment
        hit = ray_disc(origin, bearing, centre, radius)
        aside = (centre[0] - origin[0]) * math.sin(bearing) - (centre[1] - origin[1]) * math.cos(
            bearing
        )
        if min(abs(abs(aside) - radius), abs(distance - radius), abs(hit - nearest)) < 1e-9:
            continue  # rounding decides on which side of the edge it is
        visible = nearest <= hit <= farthest and not old <= hit
        assert new == pytest.approx(hit if visible else old, abs=2e-6, nan_ok=True)


def test_fake_object_waits_for_the_odometry():
    message = scan()
    result = execute(builtin("fake_object"), 1).on_message(message, stamp(0), 0.0)
    assert result.outputs[0].message is message
    assert (result.truth.operation, result.truth.detail) == ("passthrough", "no odom yet")


# The rest of the built-in ones.


def test_a_frozen_sensor_repeats_one_scan_under_new_stamps():
    messages = list(scans(5))
    for message, result in zip(messages, results(builtin("sensor_freeze"), messages), strict=True):
        heard = result.outputs[0].message
        assert heard.header == message.header
        assert heard.ranges is messages[0].ranges


def test_a_replay_plays_what_came_before_the_onset_in_a_loop():
    execution = start(builtin("sensor_replay"))
    messages = list(scans(90))
    heard = [
        execution.on_message(message, stamp(n), (n - 30) / 5).outputs[0].message
        for n, message in enumerate(messages)
    ]
    assert all(one is other for one, other in zip(heard[:30], messages, strict=False))
    for n in range(30, 90):
        assert heard[n].ranges is messages[5 + (n - 30) % 25].ranges
        assert heard[n].header == messages[n].header


def test_lost_scans_are_about_as_many_as_asked_for():
    found = results(builtin("sensor_drop"), list(scans(400)), share=0.25)
    lost = [result for result in found if not result.outputs]
    assert 70 <= len(lost) <= 130
    assert {(r.truth.operation, r.truth.magnitude, r.truth.detail) for r in lost} == {
        ("drop", 1.0, "dropped")
    }


def test_late_scans_are_late_by_the_delay_and_its_jitter():
    for n, result in enumerate(results(builtin("sensor_delay"), list(scans(50)))):
        ((due_ns, _, _),) = result.outputs
        late_s = (due_ns - stamp(n)) / 1e9
        assert 0.5 <= late_s <= 0.55
        assert result.truth.magnitude == pytest.approx(late_s, abs=1e-9)


def test_drift_grows_with_the_time_since_the_onset():
    messages = [scan(n) for n in range(3)]
    for n, result in enumerate(results(builtin("range_drift"), messages, rate=0.5)):
        np.testing.assert_allclose(result.outputs[0].message.ranges, 2.0 + 0.5 * 0.2 * n, rtol=1e-6)


def test_a_blinded_sector_has_no_returns_and_the_rest_is_unchanged():
    heard = only(builtin("blinded_sector"), scan(), centre=math.pi, half_width=0.5).ranges
    bearings = INCREMENT * np.arange(360)
    blind = np.abs(bearings - math.pi) <= 0.5
    assert np.isinf(heard[blind]).all()
    assert (heard[~blind] == 2.0).all()


def test_spoofed_odometry_slides_to_the_left_of_the_robot():
    messages = [odometry(n, 1.0, 2.0, math.pi / 2) for n in range(11)]
    position = (
        results(builtin("odometry_spoof"), messages)[10].outputs[0].message.pose.pose.position
    )
    assert (position.x, position.y) == pytest.approx((1.0 - 0.02 * 2.0, 2.0))


def test_injected_commands_come_from_the_timer_alone():
    execution = start(builtin("command_injection"), rate=20.0, speed=0.1)
    assert execution.timer_period_ns == 50_000_000
    (command,) = examples(execution.program, 1)
    assert execution.on_message(command, stamp(0), 0.0).outputs == []
    ((due_ns, sent, _),) = execution.on_timer(stamp(1), 0.2).outputs
    assert (due_ns, sent.linear.x, sent.angular.z) == (stamp(1), 0.1, 0.5)


def test_a_flood_is_the_same_scan_many_times():
    message = scan()
    (result,) = results(builtin("topic_flood"), [message], copies=7, spacing=0.01)
    assert [output.due_ns for output in result.outputs] == [
        stamp(0) + 10_000_000 * n for n in range(7)
    ]
    assert all(output.message is message for output in result.outputs)


def test_a_held_object_is_before_the_robot_wherever_it_looks():
    heard = only(builtin("held_object"), scan(), ahead=0.3, radius=0.15).ranges
    bearings = INCREMENT * np.arange(360)
    hits = np.array([ray_disc((0.0, 0.0), bearing, (0.3, 0.0), 0.15) for bearing in bearings])
    np.testing.assert_allclose(heard, np.minimum(hits, 2.0), atol=1e-6)
    assert heard.min() == pytest.approx(0.15)


# Hard negatives.


@given(ranges)
def test_the_median_of_three_rays_goes_around_the_scan(values):
    heard = only(builtin("benign_median"), scan(0, values)).ranges
    three = np.stack([np.roll(values, 1), values, np.roll(values, -1)])
    known = ~np.isnan(three).any(axis=0)
    np.testing.assert_array_equal(heard[known], np.median(three, axis=0)[known])


def test_benign_noise_has_a_standard_deviation_of_a_centimetre():
    noisy = [result.outputs[0].message.ranges for result in
             results(builtin("benign_noise"), [scan(n) for n in range(50)])]  # fmt: skip
    assert np.std(noisy) == pytest.approx(0.01, rel=0.05)
    assert np.mean(noisy) == pytest.approx(2.0, abs=0.001)
