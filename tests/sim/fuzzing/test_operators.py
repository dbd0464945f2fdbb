import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sim.fuzzing.fields import converter, difference, replaced
from sim.fuzzing.random import Draws
from sim.fuzzing.value_types import Array, Number, Text, message_type, zero
from tests.sim.fuzzing.workbench import data, doing, only, ranges, results, scan, stamp

IMAGE = "sensor_msgs/msg/Image"
JOINTS = "sensor_msgs/msg/JointState"
TF = "tf2_msgs/msg/TFMessage"
RANGE = "sensor_msgs/msg/Range"
WHOLE = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]


def message(msgtype, **fields):
    return dataclasses.replace(zero(message_type(msgtype)), **fields)


def transforms(*xs):
    one = zero(message_type("geometry_msgs/msg/TransformStamped"))
    way = ("transform", "translation", "x")
    return message(TF, transforms=[replaced(one, way, x) for x in xs])


# What is stored in a field.


@pytest.mark.parametrize("kind", WHOLE)
@given(st.integers(-(2**63), 2**63 - 1))
def test_a_whole_number_wraps_as_in_the_language_of_the_field(kind, value):
    bits = 8 * np.dtype(kind).itemsize
    expected = np.array([value % 2**bits], f"u{bits // 8}").view(kind)
    assert converter(Number(kind))(value, 0) == expected[0]
    stored = converter(Array(Number(kind)))(np.array([value]), np.zeros(1, kind))
    assert stored.dtype == kind
    assert stored[0] == expected[0]


@pytest.mark.parametrize("kind", WHOLE)
@given(st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False))
def test_a_clipped_number_is_the_nearest_that_the_field_holds(kind, value):
    limits = np.iinfo(kind)
    clip = converter(Number(kind), "clip")
    assert clip(value, 0) == min(max(round(value), limits.min), limits.max)


@pytest.mark.parametrize("kind", WHOLE)
@given(hnp.arrays(np.float64, 8, elements=st.floats(-(2**62), 2**62)))
def test_arrays_are_stored_as_their_elements_would_be(kind, values):
    for overflow in ("wrap", "clip"):
        stored = converter(Array(Number(kind)), overflow)(values, np.zeros(8, kind))
        one = converter(Number(kind), overflow)
        assert stored.tolist() == [one(value, 0) for value in values.tolist()]


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_non_finite_value_leaves_an_integer_unchanged(value):
    assert converter(Number("uint8"))(value, 7) == 7
    stored = converter(Array(Number("uint8")))(np.array([value, 3.0]), np.array([7, 7], np.uint8))
    assert stored.tolist() == [7, 3]


def test_a_number_too_large_for_float32_is_infinite():
    assert only(doing("set: {field: angle_min, value: 1e300}"), scan()).angle_min == np.inf


def test_a_text_is_cut_to_the_bound_of_its_field():
    assert converter(Text(3))("abcdef", "") == "abc"


@pytest.mark.parametrize(("overflow", "expected"), [("wrap", 44), ("clip", 255), ("error", None)])
def test_an_overflow_wraps_is_clipped_or_leaves_the_message_unchanged(overflow, expected):
    change = f"set: {{field: radiation_type, value: 300, on_overflow: {overflow}}}"
    came = message(RANGE, radiation_type=1)
    (result,) = results(doing(change, msgtype=RANGE), [came])
    if expected is None:
        assert result.outputs[0].message is came
        assert (result.truth.operation, result.truth.detail) == ("passthrough", "300 is no uint8")
    else:
        assert result.outputs[0].message.radiation_type == expected


@given(hnp.arrays(np.float32, 12, elements=st.floats(-10, 10, width=32)), st.integers(0, 11))
def test_the_difference_of_arrays_is_their_largest_change(old, place):
    new = old.copy()
    new[place] += np.float32(1.5)
    assert difference("a", old, new) == (pytest.approx(1.5, abs=1e-5), "1 of 12 a")
    assert difference("a", old, old.copy()) == (0.0, "0 of 12 a")


def test_nan_that_stays_is_no_change():
    values = np.array([np.nan, 1.0], np.float32)
    assert difference("a", values, values.copy()) == (0.0, "0 of 2 a")


# Operators on values.


def test_set_puts_one_number_into_every_element():
    heard = only(doing("set: {field: ranges, value: msg.range_max}"), scan())
    assert (heard.ranges == np.float32(20.0)).all()
    assert heard.ranges.dtype == np.float32


def test_set_puts_an_array_in_the_place_of_another():
    came = scan(0, np.arange(5))
    heard = only(doing("set: {field: intensities, value: msg.ranges}"), came)
    assert heard.intensities.tolist() == came.ranges.tolist()
    heard = only(doing("set: {field: ranges, value: '[1.0, 2.0]'}"), came)
    assert heard.ranges.tolist() == [1.0, 2.0]


def test_set_reaches_into_nested_messages_and_copies_only_the_way_there():
    came = scan()
    heard = only(doing("set: {field: header.frame_id, value: '\"map\"'}"), came)
    assert heard.header.frame_id == "map"
    assert heard.header.stamp is came.header.stamp
    assert heard.ranges is came.ranges
    assert came.header.frame_id == "base_scan_tom"


@pytest.mark.slow
@given(ranges, st.floats(-5, 5))
def test_arithmetic_leaves_non_finite_numbers_unchanged(values, by):
    for operator, expected in (("add", np.add), ("scale", np.multiply)):
        heard = only(doing(f"{operator}: {{field: ranges, by: {by!r}}}"), scan(0, values)).ranges
        finite = np.isfinite(values)
        np.testing.assert_array_equal(heard[~finite], values[~finite])
        wanted = expected(values[finite].astype(np.float64), by).astype(np.float32)
        np.testing.assert_array_equal(heard[finite], wanted)


def test_arithmetic_can_be_applied_to_non_finite_numbers():
    came = scan(0, [np.inf, 1.0])
    heard = only(doing("scale: {field: ranges, by: -1.0, nonfinite: apply}"), came)
    assert heard.ranges.tolist() == [-np.inf, -1.0]


def test_arithmetic_on_bytes_wraps():
    came = message(IMAGE, data=np.array([0, 250, 255], np.uint8))
    heard = only(doing("add: {field: data, by: 10}", msgtype=IMAGE), came)
    assert heard.data.tolist() == [10, 4, 9]
    assert heard.data.dtype == np.uint8


def test_gaussian_noise_is_as_wide_as_asked_for():
    came = scan(0, np.full(4000, 5.0))
    heard = only(doing("noise: {field: ranges, dist: gauss, absolute: 0.2}"), came).ranges
    assert np.mean(heard) == pytest.approx(5.0, abs=0.02)
    assert np.std(heard) == pytest.approx(0.2, rel=0.05)


def test_noise_on_one_number_is_drawn_as_for_an_array_of_one():
    compiled = doing("noise: {field: range, dist: uniform, absolute: 0.5}", msgtype=RANGE)
    heard = only(compiled, message(RANGE, range=1.0))
    draw = Draws(1, 0).generator(0, operation=2).random()  # the spread is operation 1
    assert heard.range == np.float32(1.0 + (draw - 0.5))


@pytest.mark.slow
@given(ranges)
def test_map_array_sees_elements_and_indices(values):
    heard = only(
        doing("map_array: {field: ranges, as: [r, i], value: r if i % 2 == 0 else i + 0.5}"),
        scan(0, values),
    ).ranges
    np.testing.assert_array_equal(heard[::2], values[::2])
    odd = np.where(np.isfinite(values), np.arange(360) + 0.5, values)[1::2]
    np.testing.assert_array_equal(heard[1::2], odd.astype(np.float32))


def test_for_each_changes_the_messages_that_its_condition_picks():
    compiled = doing(
        "for_each: {field: transforms, as: [tf, i], when: i > 0, let: {far: tf.transform."
        "translation.x * 2.0}, do: [{set: {field: transform.translation.y, value: far}}]}",
        msgtype=TF,
    )
    came = transforms(1.0, 2.0, 3.0)
    heard = only(compiled, came)
    assert [t.transform.translation.y for t in heard.transforms] == [0.0, 4.0, 6.0]
    assert heard.transforms[0] is came.transforms[0]


def test_every_round_of_for_each_has_independent_draws():
    noise = "{noise: {field: transform.translation.x, dist: uniform, absolute: 1.0}}"
    compiled = doing(f"for_each: {{field: transforms, as: [tf], do: [{noise}]}}", msgtype=TF)
    xs = [t.transform.translation.x for t in only(compiled, transforms(*[0.0] * 50)).transforms]
    assert len(set(xs)) == 50


@given(hnp.arrays(np.float32, st.integers(0, 30), elements=st.floats(0, 10, width=32)))
def test_remove_where_keeps_the_others_in_order(values):
    heard = only(doing("remove_where: {field: ranges, as: [r], where: r > 5.0}"), scan(0, values))
    assert heard.ranges.tolist() == [value for value in values.tolist() if value <= 5.0]


def test_remove_where_takes_texts_and_messages_too():
    named = message(JOINTS, name=["left", "right", "left"])
    heard = only(
        doing("remove_where: {field: name, as: [n], where: n == 'left'}", msgtype=JOINTS), named
    )
    assert heard.name == ["right"]
    heard = only(
        doing("remove_where: {field: transforms, as: [tf, i], where: i == 1}", msgtype=TF),
        transforms(1.0, 2.0, 3.0),
    )
    assert [t.transform.translation.x for t in heard.transforms] == [1.0, 3.0]


# Operators on delivery.


def test_a_delay_is_bounded():
    for seconds, expected in (("0.25", 0.25), ("1000.0", 60.0), ("-1.0", 0.0), ("nan", 0.0)):
        (result,) = results(doing(f"delay: {{seconds: {seconds}}}"), [scan()])
        assert result.outputs[0].due_ns - stamp(0) == round(expected * 1e9)


def test_a_playback_begins_anew_after_a_message_that_it_spares():
    compiled = doing("freeze: {}", more="      when: msg.scan_time > 0.0\n")
    flags = [1.0, 1.0, 0.0, 1.0, 1.0]
    messages = [scan(n, [n], scan_time=flag) for n, flag in enumerate(flags)]
    heard = [result.outputs[0].message.ranges[0] for result in results(compiled, messages)]
    assert heard == [0.0, 0.0, 2.0, 3.0, 3.0]


def test_a_replay_without_anything_before_it_plays_what_comes_first():
    compiled = doing("replay: {messages: 3}")
    messages = [scan(n, [n]) for n in range(4)]
    heard = [result.outputs[0].message for result in results(compiled, messages)]
    assert [m.ranges[0] for m in heard] == [0.0, 0.0, 0.0, 0.0]
    assert [m.header for m in heard] == [m.header for m in messages]


def test_an_emitted_message_follows_the_one_that_came():
    came = scan()
    compiled = doing("emit: {copy: msg, fields: {header.frame_id: \"'ghost'\", range_max: 1.0}}")
    (result,) = results(compiled, [came])
    (_, first, _), (_, second, _) = result.outputs
    assert first is came
    assert (second.header.frame_id, second.range_max) == ("ghost", 1.0)
    assert second.ranges is came.ranges


def test_a_new_message_has_the_header_of_the_one_that_came_and_zeros():
    came = scan()
    (result,) = results(doing("drop: {}", "emit: {fields: {range_min: 0.5}}"), [came])
    ((_, made, _),) = result.outputs
    assert made.header is came.header
    blank = dataclasses.replace(made, range_min=0.0)
    assert data(blank) == data(dataclasses.replace(zero(message_type("sensor_msgs/msg/LaserScan")),
                                                   header=came.header))  # fmt: skip


def test_two_draws_of_one_operator_differ():
    draw = "'uniform(0.0, 1.0)'"
    compiled = doing(f"emit: {{copy: msg, fields: {{angle_min: {draw}, angle_max: {draw}}}}}")
    (result,) = results(compiled, [scan()])
    made = result.outputs[1].message
    assert made.angle_min != made.angle_max
