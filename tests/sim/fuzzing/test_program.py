import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.functions import haversine_m
from sim.fuzzing.random import Draws
from sim.fuzzing.scenario import ScenarioError
from sim.scenarios import builtin_scenarios
from sim.turtlebot3 import frames
from tests.sim.fuzzing.workbench import (
    BUILTINS,
    INCREMENT,
    REPORT,
    SCAN,
    builtin,
    data,
    doing,
    examples,
    frozen,
    odometry,
    only,
    program,
    ranges,
    report,
    results,
    scan,
    scans,
    scenario,
    stamp,
    start,
)

PASSTHROUGHS = [
    name
    for name in BUILTINS
    if builtin(name).type.name == SCAN and builtin(name).scenario.control == "passthrough"
]
TARGET = "C07AB1"


class Replayed(random.Random):
    """Python's generator, but its draws are given."""

    def __init__(self, draws):
        super().__init__()
        self._draws = iter(draws)

    def random(self):
        return float(next(self._draws))


def noise_number(compiled):
    ((noise,),) = [action.do for action in compiled.actions]
    return noise.number


# What every program owes.


@pytest.mark.parametrize("name", BUILTINS)
def test_no_program_writes_to_the_messages_that_it_hears(name):
    compiled = builtin(name)
    messages = examples(compiled)
    before = [data(message) for message in frozen(messages)]
    results(compiled, messages)
    assert [data(message) for message in messages] == before


@pytest.mark.parametrize("name", BUILTINS)
def test_the_same_run_gives_the_same_bytes_and_another_seed_may_not(name):
    compiled = builtin(name)

    def told(seed):
        found = results(compiled, examples(compiled), seed)
        return [[(due, data(m)) for due, m in r.outputs] + [r.truth] for r in found]

    assert told(1) == told(1)
    noise = {"random_noise", "random_noise_thesis", "benign_noise"}
    drawing = noise | {"sensor_drop", "sensor_delay", "message_mutator", "benign_drop"}
    assert (told(1) != told(2)) == (name in drawing)


@pytest.mark.parametrize("name", BUILTINS)
def test_a_shadow_does_the_same_work_and_publishes_what_came(name):
    attack = builtin(name)
    shadow = compile_scenario(builtin_scenarios()[name].as_shadow(), allow_actuation=True)
    messages = examples(attack)
    done, withheld = results(attack, messages), results(shadow, messages)
    for number, message in enumerate(messages):
        ((due_ns, output),) = withheld[number].outputs
        assert due_ns == stamp(number)
        assert output is message
        truth = withheld[number].truth
        assert (truth.operation, truth.magnitude) == (done[number].truth.operation, 0.0)


@pytest.mark.parametrize("name", ["random_noise", "random_noise_thesis", "message_mutator"])
@given(lost=st.sets(st.integers(0, 19)))
def test_what_becomes_of_a_message_does_not_depend_on_those_lost_before(name, lost):
    compiled = builtin(name)
    messages = list(scans(20))
    whole = results(compiled, messages)
    execution = start(compiled)
    for number, message in enumerate(messages):
        if number not in lost:
            ((_, output),) = execution.on_message(message, stamp(number), 0.2 * number).outputs
            assert data(output) == data(whole[number].outputs[0].message)


@pytest.mark.parametrize("name", BUILTINS)
def test_before_its_onset_a_program_hands_on_what_comes(name):
    execution = start(builtin(name))
    (message,) = examples(execution.program, 1)
    ((_, output),) = execution.on_message(message, stamp(0), -0.1).outputs
    assert output is message
    assert execution.on_timer(stamp(0), -0.1).outputs == []


def test_messages_without_a_stamp_draw_by_their_number():
    compiled = doing("noise: {field: ranges, dist: uniform, relative: 0.1}")
    unstamped = replace(scan(), header=scan(-1).header)
    first, second = results(compiled, [unstamped, unstamped])
    assert data(first.outputs[0].message) != data(second.outputs[0].message)


@pytest.mark.parametrize("control", ["passthrough", "shadow"])
def test_the_timer_of_a_control_publishes_nothing(control):
    document = {**builtin_scenarios()["atc_ghost_static"].document, "control": control}
    ghost = replace(builtin_scenarios()["atc_ghost_static"], document=document)
    assert start(compile_scenario(ghost)).on_timer(stamp(5), 1.0).outputs == []


# The thesis's modes.


@pytest.mark.parametrize("name", PASSTHROUGHS)
@given(ranges)
def test_passthrough_hands_on_the_very_object(name, values):
    message = scan(0, values)
    (result,) = results(builtin(name), [message])
    ((due_ns, output),) = result.outputs
    assert due_ns == stamp(0)
    assert output is message
    assert (result.truth.operation, result.truth.magnitude) == ("passthrough", 0.0)


@given(ranges, st.floats(0.0, 1.0), st.integers(0, 1000))
def test_random_noise_thesis_is_the_formula_of_the_thesis(values, level, number):
    compiled = builtin("random_noise_thesis")
    message = scan(number, values)
    heard = only(compiled, message, level=level)
    draws = Draws(1, compiled.scenario.seed).uniform(
        stamp(number), noise_number(compiled), len(values)
    )
    generator = Replayed(draws)
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


def test_the_truth_of_noise_says_how_many_ranges_and_by_how_much():
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
    ((_, heard),) = execution.on_message(message, stamp(1), 0.2).outputs
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


def test_a_frozen_sensor_shows_one_scan_under_the_stamps_that_come():
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
        ((due_ns, _),) = result.outputs
        late_s = (due_ns - stamp(n)) / 1e9
        assert 0.5 <= late_s <= 0.55
        assert result.truth.magnitude == pytest.approx(late_s, abs=1e-9)


def test_drift_grows_with_the_time_since_the_onset():
    messages = [scan(n) for n in range(3)]
    for n, result in enumerate(results(builtin("range_drift"), messages, rate=0.5)):
        np.testing.assert_allclose(result.outputs[0].message.ranges, 2.0 + 0.5 * 0.2 * n, rtol=1e-6)


def test_a_blinded_sector_has_no_returns_and_the_rest_is_as_it_was():
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
    ((due_ns, sent),) = execution.on_timer(stamp(1), 0.2).outputs
    assert (due_ns, sent.linear.x, sent.angular.z) == (stamp(1), 0.1, 0.5)


def test_a_flood_is_the_same_scan_many_times():
    message = scan()
    (result,) = results(builtin("topic_flood"), [message], copies=7, spacing=0.01)
    assert [due_ns for due_ns, _ in result.outputs] == [stamp(0) + 10_000_000 * n for n in range(7)]
    assert all(output is message for _, output in result.outputs)


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


def test_benign_noise_is_a_centimetre():
    noisy = [result.outputs[0].message.ranges for result in
             results(builtin("benign_noise"), [scan(n) for n in range(50)])]  # fmt: skip
    assert np.std(noisy) == pytest.approx(0.01, rel=0.05)
    assert np.mean(noisy) == pytest.approx(2.0, abs=0.001)


# Air traffic.


def reports(name, *messages, **parameters):
    return results(builtin(name), messages, **parameters)


def published(found):
    return [[output for _, output in result.outputs] for result in found]


def test_deletion_by_address_takes_one_aircraft_only():
    mine, other = report(0), report(1, "C07AB2")
    assert published(reports("atc_delete_by_id", mine, other)) == [[], [other]]


def test_padding_of_a_text_does_not_save_an_aircraft():
    assert published(reports("atc_delete_by_id", report(0, f"{TARGET} \0"))) == [[]]


def test_deletion_for_a_while_begins_and_ends():
    messages = [report(n, callsign="ACA123") for n in range(11)]
    found = reports("atc_delete_timer_callsign", *messages, start_s=0.4, length_s=1.0)
    assert [len(outputs) for outputs in published(found)] == [1, 1, 0, 0, 0, 0, 0, 1, 1, 1, 1]


def test_a_dead_zone_is_a_circle_on_the_earth():
    near = report(0, latitude=44.2253 + 0.04, longitude=-76.5967)
    far = report(1, latitude=44.2253 + 0.05, longitude=-76.5967)
    assert published(reports("atc_deadzone", near, far)) == [[], [far]]


def test_a_static_ghost_is_reported_every_second_under_new_stamps():
    execution = start(builtin("atc_ghost_static"))
    real = report(0, "REAL")
    assert execution.on_message(real, stamp(0), 0.0).outputs[0].message is real
    assert execution.timer_period_ns == 1_000_000_000
    ((_, ghost),) = execution.on_timer(stamp(9), 1.8).outputs
    assert (ghost.icao24, ghost.latitude, ghost.altitude_m) == ("GHOST1", 44.25, 1500.0)
    assert ghost.header == report(9).header


@given(st.floats(-60, 60), st.floats(-170, 170), st.floats(0, 360))
def test_a_following_ghost_is_behind_its_leader(latitude, longitude, track):
    leader = report(0, latitude=latitude, longitude=longitude, track_deg=track, altitude_m=900.0)
    (outputs,) = published(reports("atc_ghost_following", leader, behind_m=3000.0))
    real, ghost = outputs
    assert real is leader
    assert (ghost.icao24, ghost.altitude_m, ghost.header) == ("GHOST2", 900.0, leader.header)
    distance = haversine_m(latitude, longitude, ghost.latitude, ghost.longitude)
    assert distance == pytest.approx(3000.0, rel=1e-6)


def test_a_sinking_report_never_goes_below_the_ground():
    messages = [report(n, altitude_m=10.0) for n in range(20)]
    found = published(reports("atc_altitude_decrease", *messages))
    altitudes = [outputs[0].altitude_m for outputs in found]
    assert altitudes == pytest.approx([max(0.0, 10.0 - n) for n in range(20)])


def test_an_altered_position_drifts_off_on_its_bearing():
    messages = [report(n, latitude=44.0, longitude=-76.0) for n in range(11)]
    ((last,),) = published(reports("atc_gps_alteration", *messages, drift_m_s=100.0))[10:]
    assert haversine_m(44.0, -76.0, last.latitude, last.longitude) == pytest.approx(200.0)
    assert last.longitude > -76.0


def test_the_follower_is_right_behind_the_nearest_other():
    near = report(0, "NEAR", latitude=44.1, longitude=-76.0, track_deg=0.0, altitude_m=700.0)
    far = report(1, "FAR", latitude=45.0, longitude=-76.0)
    mine = report(2, TARGET, latitude=44.0, longitude=-76.0)
    ((follower,),) = published(reports("atc_follow_closest", near, far, mine, gap_m=500.0))[2:]
    assert follower.altitude_m == 700.0
    assert haversine_m(44.1, -76.0, follower.latitude, follower.longitude) == pytest.approx(500.0)
    assert follower.latitude < 44.1


def test_the_follower_forgets_who_was_not_heard_of_for_long():
    execution = start(builtin("atc_follow_closest"))
    execution.on_message(report(0, "GONE"), stamp(0), 0.0)
    later = 200
    message = report(later)
    result = execution.on_message(message, stamp(later), 0.2 * later)
    assert result.outputs[0].message is message


# The language.


def test_all_values_of_an_action_read_the_original():
    report_ = report(0, latitude=1.0, longitude=2.0)
    swap = doing(
        "set: {field: latitude, value: msg.longitude}",
        "set: {field: longitude, value: msg.latitude}",
        msgtype=REPORT,
    )
    heard = only(swap, report_)
    assert (heard.latitude, heard.longitude) == (2.0, 1.0)


TWO_ACTIONS = """\
transform:
  match: {match}
  actions:
    - name: one
      do: [{{add: {{field: altitude_m, by: 1.0}}}}]
    - name: never
      when: msg.altitude_m < 0.0
      do: [{{drop: {{}}}}]
    - name: two
      do: [{{scale: {{field: altitude_m, by: 10.0}}}}]
"""


@pytest.mark.parametrize(
    ("match", "altitude_m", "operation"), [("first", 3.0, "one"), ("all", 30.0, "one+two")]
)
def test_the_first_action_that_matches_is_done_or_all_one_after_the_other(
    match, altitude_m, operation
):
    (result,) = results(
        program(TWO_ACTIONS.format(match=match), REPORT), [report(0, altitude_m=2.0)]
    )
    assert result.outputs[0].message.altitude_m == altitude_m
    assert result.truth.operation == operation


def test_state_is_kept_from_message_to_message():
    compiled = program(
        """\
state: {count: {type: int, default: 0}}
transform:
  always:
    - store: {into: count, value: state.count + 1}
    - set: {field: altitude_m, value: state.count}
""",
        REPORT,
    )
    for _ in range(2):  # a second run begins anew
        found = results(compiled, [report(n) for n in range(3)])
        assert [r.outputs[0].message.altitude_m for r in found] == [1.0, 2.0, 3.0]


def test_a_full_table_gives_up_the_row_that_was_stored_first():
    compiled = program(
        """\
state: {seen: {type: map, value: {count: int}, max_size: 2}}
transform:
  always:
    - store:
        into: seen
        key: msg.icao24
        value: {count: "state.seen[msg.icao24].count + 1"}
    - set: {field: altitude_m, value: "state.seen[msg.icao24].count"}
""",
        REPORT,
    )
    addresses = ["a", "b", "a", "c", "b", "a"]
    found = results(compiled, [report(n, icao24) for n, icao24 in enumerate(addresses)])
    counts = [result.outputs[0].message.altitude_m for result in found]
    assert counts == [1.0, 1.0, 2.0, 1.0, 1.0, 1.0]


def test_a_window_and_a_probability_limit_what_is_touched():
    compiled = program(
        """\
activation: {duration_s: 40.0, probability: 0.5}
transform: {actions: [{name: hide, do: [{drop: {}}]}]}
"""
    )
    found = results(compiled, [scan(n) for n in range(300)])
    dropped = [n for n, result in enumerate(found) if not result.outputs]
    assert 70 <= len(dropped) <= 130
    assert max(dropped) < 200


def test_a_stale_source_may_cost_the_message():
    rest = """\
sources:
  odom: {type: nav_msgs/msg/Odometry, topic: /odom, max_age: 0.3, on_missing: drop}
transform: {actions: [{name: slow, do: [{scale: {field: ranges, by: 2.0}}]}]}
"""
    execution = start(program(rest))
    assert len(execution.on_message(scan(1), stamp(1), 0.2).outputs) == 1
    late = execution.on_message(scan(2), stamp(2), 0.4)
    assert late.outputs == []
    assert late.truth.detail == "dropped: odom is 0.4 s old"


def test_an_array_longer_than_allowed_is_handed_on_and_the_truth_says_so():
    compiled = doing("scale: {field: ranges, by: 2.0}", more="limits: {array: 100}\n")
    message = scan()
    (result,) = results(compiled, [message])
    assert result.outputs[0].message is message
    assert result.truth.detail == "ranges has 360 elements, limits.array is 100"


def test_the_truth_counts_what_was_published_before():
    found = results(doing("duplicate: {copies: 3}"), [scan(n) for n in range(3)])
    assert [result.truth.index for result in found] == [0, 3, 6]


def test_a_scenario_may_say_what_its_magnitude_is():
    more = "parameters: {m: {type: float, default: 4.5}}\nground_truth: {magnitude: p.m}\n"
    (result,) = results(doing("drop: {}", more=more), [scan()])
    assert result.truth.magnitude == 4.5


def test_no_more_is_published_for_a_message_than_allowed():
    compiled = doing("duplicate: {copies: 500}", more="limits: {outputs: 10}\n")
    ((result),) = results(compiled, [scan()])
    assert len(result.outputs) == 10


# What is refused.


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"level": 1.5}, r"parameters\.level: expected 0\.0 to 1\.0, found 1\.5"),
        ({"level": math.nan}, "expected 0.0 to 1.0, found nan"),
        ({"level": "much"}, "expected a number, found 'much'"),
        ({"level": True}, "expected a number, found True"),
        ({"volume": 1.0}, "expected one of level, found volume"),
    ],
)
def test_a_run_cannot_have_parameters_that_the_scenario_does_not_allow(parameters, expected):
    with pytest.raises(ScenarioError, match=expected):
        execute(builtin("random_noise"), 1, parameters)


ACT = "transform: {{actions: [{{name: act, do: [{}]}}]}}\n"


@pytest.mark.parametrize(
    ("rest", "where", "expected"),
    [
        (ACT.format("{set: {field: rangs, value: 1}}"), "field", "expected a field of sensor_msgs"),
        (ACT.format("{set: {field: ranges, value: msg.rangs}}"), "value", "no field 'rangs'"),
        (ACT.format("{set: {field: angle_min, value: '\"a\"'}}"), "value", "found a text"),
        (ACT.format("{set: {field: header, value: 1}}"), "value", "expected a std_msgs/msg/Header"),
        (ACT.format("{add: {field: header, by: 1}}"), "field", "expected a number or an array"),
        (ACT.format("{map_array: {field: angle_min, as: [r], value: r}}"), "field", "an array of"),
        (ACT.format("{map_array: {field: ranges, as: [p], value: 1}}"), "as", "taken"),
        (ACT.format("{for_each: {field: ranges, as: [r], do: []}}"), "field", "array of messages"),
        (ACT.format("{remove_where: {field: angle_min, as: [r], where: true}}"), "field", "array"),
        (ACT.format("{noise: {field: ranges, dist: gauss, clip: [0, 1]}}"), "noise", "one of"),
        (ACT.format("{store: {into: x, value: 1}}"), "into", "name under state, found x"),
        (ACT.format("{emit: {fields: {nothing: 1}}}"), "fields.nothing", "expected a field of"),
        (ACT.format("{delay: {seconds: 'true'}}"), "seconds", "expected a number"),
        (ACT.format("{drop: {}}, {set: {field: angle_min, value: 1}}, "
                    "{add: {field: angle_min, by: 1}}"), "do[2].add.field", "no operator above"),
        ("transform: {timer: {period_s: 1, do: [{drop: {}}]}}\n", "drop", "one of emit, store"),
        ("transform: {timer: {period_s: 1, do: [{emit: {copy: msg, fields: {}}}]}}\n", "copy", "a"),
        ("transform: {timer: {period_s: 1, do: [{emit: {fields: {angle_min: msg.angle_max}}}]}}\n",
         "angle_min", "'msg' is unknown"),
        ("transform: {actions: [{name: a, when: 1, do: []}]}\n", "when", "expected a boolean"),
        ("functions: {f: {params: [], expr: fn.f()}}\n", "functions", "cannot call themselves"),
        ("functions: {f: {params: [msg], expr: 1 +}}\n", "functions.f", "expected"),
        ("sources: {s: {type: nav_msgs/msg/Nothing, topic: /s}}\n", "sources.s.type", "unknown"),
        ("parameters: {a: {type: int, default: 1.5}}\n", "parameters.a.default", "a whole number"),
        ("parameters: {a: {type: float, default: 2, max: 1}}\n", "parameters.a.default", "to 1"),
        ("state: {a: {type: bool, default: 1}}\n", "state.a.default", "true or false"),
        ("constants: {a: [1, [2, 3]]}\n", "constants.a", "all numbers or all pairs"),
    ],
    ids=lambda value: value[:60],
)  # fmt: skip
def test_what_does_not_fit_the_types_is_refused_with_its_place(rest, where, expected):
    with pytest.raises(ScenarioError) as refused:
        program(rest)
    text = str(refused.value)
    assert text.startswith("tried.yaml:5: ")
    key, _, reason = text.removeprefix("tried.yaml:5: ").partition(": ")
    assert key.endswith(where)
    assert expected in reason


@pytest.mark.parametrize(
    "topic",
    ["/cmd_vel", "/cmd_vel_nav", "/robot1/cmd_vel", "/arm/joint_trajectory",
     "/mavros/setpoint_velocity/cmd_vel", "/fmu/in/trajectory_setpoint"],
)  # fmt: skip
def test_what_moves_something_needs_leave(topic):
    moving = scenario(msgtype="geometry_msgs/msg/Twist")
    moving.document["main"]["output"] = topic
    with pytest.raises(ScenarioError, match="moves nothing"):
        compile_scenario(moving)
    assert compile_scenario(moving, allow_actuation=True).output_topic == topic


@pytest.mark.parametrize("topic", ["/in", "/odom", "/_oracle/ground_truth"])
def test_output_is_neither_what_is_heard_nor_the_ground_truth(topic):
    looped = scenario("sources: {odom: {type: nav_msgs/msg/Odometry, topic: /odom}}\n")
    looped.document["main"]["output"] = topic
    with pytest.raises(ScenarioError, match="main"):
        compile_scenario(looped)


def test_what_computes_too_much_is_refused_before_it_runs():
    many = [f"map_array: {{field: {f}, as: [r], value: r + 1}}" for f in ("ranges", "intensities")]
    doing(*many)
    with pytest.raises(ScenarioError, match=r"at most \d+ elements computed .* limits\.array"):
        doing(*many, more="limits: {array: 4194304}\n")
