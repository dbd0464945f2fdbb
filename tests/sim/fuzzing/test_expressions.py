"""The semantics and the cost of expressions."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import typestore
from sim.fuzzing.expressions import compile_expression
from sim.fuzzing.random import Draws
from sim.fuzzing.scopes import Scope
from sim.fuzzing.value_types import FLOAT, INTEGER, Number, message_type, missing
from tests.sim.fuzzing.language import (
    ELEMENT,
    GLOBAL,
    LOOP,
    SCAN,
    VECTORS,
    assert_is_value,
    boolean,
    compiled,
    environments,
    is_value,
    lengths,
    number,
)

pytestmark = pytest.mark.usefixtures("quiet")


@pytest.mark.slow
@given(number | boolean, environments())
def test_a_sentence_over_arrays_is_the_sentence_over_each_element(text, env):
    together, each = compiled(text, LOOP), compiled(text, ELEMENT)
    if together is None:
        return
    n = len(env["r"])
    expected = [each({**env, **{name: env[name][k] for name in VECTORS}}) for k in range(n)]
    found = together(env)
    if together.vector:
        np.testing.assert_array_equal(found, np.array(expected, found.dtype))
        assert together.cost > each.cost
    else:
        np.testing.assert_array_equal([found] * n, np.array(expected, type(found)))
        assert together.cost == each.cost


@pytest.mark.slow
@given(number | boolean, environments())
def test_every_sentence_gives_a_value_of_its_type_whatever_the_data(text, env):
    expression = compiled(text, LOOP)
    if expression is not None:
        assert_is_value(expression(env), expression, len(env["r"]))


@pytest.mark.slow
@given(number, environments())
def test_a_function_is_the_text_that_it_stands_for(text, env):
    call, body = compiled(f"fn.double({text})", LOOP), compiled(f"({text}) + ({text})", LOOP)
    if call is not None and body is not None:
        assert (call.type, call.vector, call.names) == (body.type, body.vector, body.names)
        np.testing.assert_array_equal(call(env), body(env))


@pytest.mark.slow
@given(number | boolean, environments())
def test_an_expression_reads_its_environment_and_leaves_it_alone(text, env):
    expression = compiled(text, LOOP)
    if expression is None:
        return
    before = {name: np.array(env[name]) for name in VECTORS}
    names = list(env)
    once = expression(env)
    np.testing.assert_array_equal(expression(env), once)
    assert list(env) == names
    for name, value in before.items():
        np.testing.assert_array_equal(env[name], value)


# Meaning.


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7 // 2", 3), ("-7 // 2", -4), ("-7 % 3", 2), ("7 / 2", 3.5), ("2 ** 3", 8.0),
        ("1 / 0", math.inf), ("-1 / 0", -math.inf), ("7 // 0", 0), ("7 % 0", 0),
        ("1.5 // 0", math.inf), ("1e308 * 10", math.inf), ("0 ** -1", math.inf),
        ("9223372036854775807 + 1", -(2**63)), ("abs(-9223372036854775807 - 1)", -(2**63)),
        ("4611686018427387904 * 2", -(2**63)), ("nan == nan", False), ("inf == inf", True),
        ("1 == 1.0", True), ("1 < 2 < 3", True), ("1 < 3 < 2", False), ("1 if true else 2.5", 1.0),
        ("True and not False", True), ("min(3, 1, 2)", 1), ("max(1, 2.5)", 2.5),
        ("floor(-1.5)", -2.0), ("clamp(5, 0, 3)", 3), ("is_finite(inf)", False),
        ("[4, 5][1]", 5.0), ("len('ab ')", 2),
        ("wrap_angle(3 * pi)", -math.pi), ("'ab' == 'ab '", True), ("'ab' == ' ab'", False),
    ],
)  # fmt: skip
def test_arithmetic_is_that_of_int64_and_float64(text, value):
    found = compile_expression(text, Scope({}))({})
    assert found == value
    assert type(found) is type(value)


def test_nan_goes_through_min_and_max_as_through_all_arithmetic():
    for text in (
        "min(nan, 1)",
        "max(1, nan)",
        "0 * inf",
        "sqrt(-1)",
        "0 / 0",
        "1.5 % 0",
        "inf - inf",
    ):
        assert math.isnan(compile_expression(text, Scope({}))({}))


@pytest.mark.slow
@given(st.text("ab", max_size=4), st.text("\0 ", max_size=4))
def test_padding_of_a_text_does_not_count(text, padding):
    same = compile_expression("p.name == 'ab'", GLOBAL)
    assert same({"p": {"name": text + padding}}) == (text == "ab")
    assert compile_expression("len(p.name)", GLOBAL)({"p": {"name": text + padding}}) == len(text)
    lookup = compile_expression("state.tracks[p.name].lat", GLOBAL)
    tracks = {"ab": {"lat": 1.0, "lon": 2.0, "name": ""}}
    found = lookup({"p": {"name": text + padding}, "state": {"tracks": tracks}})
    assert found == 1.0 if text == "ab" else math.isnan(found)


@given(hnp.arrays(np.float32, lengths, elements=st.floats(-9, 9, width=32)), st.data())
def test_an_element_is_numpys_inside_the_array_and_missing_outside(ranges, data):
    scan = missing(message_type(SCAN))
    scan.ranges = ranges
    index = data.draw(hnp.arrays(np.int64, 6, elements=st.integers(-3, 12)))
    found = compile_expression("msg.ranges[i]", LOOP)({"msg": scan, "i": index})
    padded = np.concatenate([np.full(3, np.nan), ranges, np.full(13, np.nan)])
    np.testing.assert_array_equal(found, padded[index + 3])


def test_an_index_between_two_elements_is_rounded_down():
    env = {"msg": missing(message_type(SCAN)), "t": 1.9}
    env["msg"].ranges = np.array([5.0, 6.0, 7.0], np.float32)
    assert compile_expression("msg.ranges[t]", GLOBAL)(env) == 6.0
    assert math.isnan(compile_expression("msg.ranges[-0.5]", GLOBAL)(env))


def test_missing_values_are_nan_zero_false_or_the_empty_text():
    env = {"path": missing(message_type("nav_msgs/msg/Path")), "state": {"tracks": {}}}
    where = compile_expression("path.poses[3].pose.position.x", GLOBAL)
    assert math.isnan(where(env))
    assert compile_expression("path.poses[3].header.frame_id == ''", GLOBAL)(env) is True
    assert compile_expression("path.poses[3].header.stamp.sec", GLOBAL)(env) == 0
    row = compile_expression("nearest(state.tracks, 0, 0, '')", GLOBAL)(env)
    assert row["name"] == ""
    assert math.isnan(row["lat"])


@given(st.integers(-(2**70), 2**70))
def test_whole_numbers_that_do_not_fit_wrap(value):
    found = compile_expression("p.n", GLOBAL)({"p": {"n": value}})
    assert (found - value) % 2**64 == 0
    assert -(2**63) <= found < 2**63


def test_every_field_of_every_message_can_be_read_with_its_type():
    for kind in map(message_type, sorted(typestore().fielddefs)):
        scope, env = Scope({"msg": kind}), {"msg": missing(kind)}
        for name, field in kind.fields.items():
            expression = compile_expression(f"msg.{name}", scope)
            if isinstance(field, Number):
                assert expression.type == (INTEGER if field.is_integer else FLOAT)
            else:
                assert expression.type == field
            assert is_value(expression(env), expression.type)


# Draws.


def test_a_draw_is_one_an_element_in_a_loop_and_one_elsewhere():
    draws = functools.partial(Draws(1, 2).generator, 3, 4)
    env = {"rng": draws, "r": np.zeros(5, np.float32), "i": np.arange(5), "b": np.ones(5, bool)}
    together = compile_expression("uniform(0, 1)", LOOP)
    assert together.vector
    np.testing.assert_array_equal(together(env), Draws(1, 2).generator(3, 4).random(5))
    assert compile_expression("uniform(0, 1)", GLOBAL)(env) == Draws(1, 2).generator(3, 4).random()


def test_two_draws_in_one_expression_are_independent():
    draws = functools.partial(Draws(1, 2).generator, 3, 4)
    difference = compile_expression("gauss(0, 1) - gauss(0, 1)", GLOBAL)({"rng": draws})
    assert difference == (
        Draws(1, 2).generator(3, 4, 0).standard_normal()
        - Draws(1, 2).generator(3, 4, 1).standard_normal()
    )


# Cost.


@pytest.mark.parametrize("elements", [1, 360, 10_000])
def test_only_operations_per_element_cost_per_element(elements):
    def cost(text):
        return compile_expression(text, LOOP, elements=elements).cost

    assert cost("sqrt(t)") == 2
    assert cost("sqrt(r)") == 2 * elements
    assert cost("in_polygon(r, t, [[0, 0], [1, 0], [1, 1], [0, 1]])") >= 4 * elements
    assert cost("nearest(state.tracks, t, t, 'a').lat") >= 16
