"""Expressions: what they accept, what they mean, and that nothing leads out of the value types."""

import ast
import functools
import math
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import message_class, typestore
from sim.fuzzing.expression_compiler import MAX_DEPTH, MAX_OPERATIONS
from sim.fuzzing.expressions import compile_expression
from sim.fuzzing.functions import BUILTINS, CONSTANTS
from sim.fuzzing.grammar import ExpressionError
from sim.fuzzing.random import Draws
from sim.fuzzing.scopes import Function, Scope
from sim.fuzzing.value_types import (
    BOOLEAN,
    FLOAT,
    INTEGER,
    Array,
    Boolean,
    Message,
    Number,
    Record,
    Table,
    Text,
    message_type,
)

SCAN = "sensor_msgs/msg/LaserScan"
ROW = Record("row", {"lat": FLOAT, "lon": FLOAT, "name": Text(8)})
NAMES = {
    "msg": message_type(SCAN),
    "odom": message_type("nav_msgs/msg/Odometry"),
    "path": message_type("nav_msgs/msg/Path"),
    "p": Record("p", {"x": FLOAT, "n": INTEGER, "on": BOOLEAN, "name": Text(8)}),
    "state": Record("state", {"tracks": Table(ROW, 16), "count": INTEGER}),
    "t": FLOAT,
}
FUNCTIONS = {
    "double": Function(("x",), "x + x"),
    "far": Function(("x", "limit"), "x > limit and x < msg.range_max"),
    "twice_far": Function(("x",), "fn.far(fn.double(x), p.x)"),
}
VECTORS = {"r": Number("float32"), "i": INTEGER, "b": BOOLEAN}
GLOBAL = Scope(NAMES, FUNCTIONS)
ELEMENT = Scope(NAMES, FUNCTIONS, VECTORS)
LOOP = Scope(NAMES, FUNCTIONS, VECTORS, tuple(VECTORS))


@pytest.fixture(scope="module", autouse=True)
def _quiet():
    """As expressions are run: NaN and infinities are values like others."""
    with np.errstate(all="ignore"):
        yield


reals = st.floats() | st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan, 1.0])
wholes = st.integers(-(2**63), 2**63 - 1) | st.integers(-3, 9)
texts = st.text(max_size=8)
lengths = st.integers(0, 9)


@st.composite
def environments(draw):
    """What an expression meets, whatever it is."""
    scan = message_type(SCAN).missing
    scan.range_min, scan.range_max = draw(reals), draw(reals)
    scan.ranges = draw(hnp.arrays(np.float32, lengths, elements=st.floats(width=32)))
    scan.intensities = draw(hnp.arrays(np.float32, lengths))
    path = message_type("nav_msgs/msg/Path").missing
    path.poses = [message_type("geometry_msgs/msg/PoseStamped").missing] * draw(lengths)
    rows = st.fixed_dictionaries({"lat": reals, "lon": reals, "name": texts})
    n = draw(lengths)
    return {
        "msg": scan,
        "odom": message_type("nav_msgs/msg/Odometry").missing,
        "path": path,
        "p": {"x": draw(reals), "n": draw(wholes), "on": draw(st.booleans()), "name": draw(texts)},
        "state": {"tracks": draw(st.dictionaries(texts, rows, max_size=4)), "count": draw(wholes)},
        "t": draw(reals),
        "r": draw(hnp.arrays(np.float32, n, elements=st.floats(width=32))),
        "i": draw(hnp.arrays(np.int64, n, elements=wholes)),
        "b": draw(hnp.arrays(bool, n)),
        "rng": functools.partial(Draws(1, 2).generator, 3, 4),
    }


def is_value(value, kind):
    """Whether a value, or each element of a vector, is of a type; closed, like the types."""
    match kind:
        case Number():
            return type(value) is (int if kind.is_integer else float)
        case Boolean():
            return type(value) is bool
        case Text():
            return type(value) is str
        case Array():
            elements = [as_plain(element) for element in value]
            return type(value) in (list, np.ndarray) and all(
                is_value(element, kind.element) for element in elements
            )
        case Message():
            fields = {name: as_plain(getattr(value, name)) for name in kind.fields}
            return type(value) is message_class(kind.name) and all(
                is_value(fields[name], kind.fields[name]) for name in fields
            )
        case Record():
            return isinstance(value, Mapping) and all(
                is_value(as_plain(value[name]), kind.fields[name]) for name in kind.fields
            )
        case Table():
            return isinstance(value, Mapping) and all(
                type(key) is str and is_value(row, kind.row) for key, row in value.items()
            )


def as_plain(value):
    return value.item() if isinstance(value, np.generic) else value


def assert_is_value(value, expression, n):
    if expression.vector:
        assert value.shape == (n,)
        assert value.dtype == (getattr(expression.type, "kind", "bool"))
    else:
        assert is_value(value, expression.type)


# Sentences of the language, by what they give.


number = st.deferred(lambda: _numbers)
boolean = st.deferred(lambda: _booleans)
_leaves = st.sampled_from(
    [
        "r", "i", "t", "p.x", "p.n", "state.count", "msg.range_min", "msg.ranges[0]",
        "0", "1", "2", "7", "0.5", "1e300", "9223372036854775807", "inf", "nan", "pi",
        "len(msg.ranges)", "len(p.name)", "len(state.tracks)", "state.tracks['a'].lat",
        "nearest(state.tracks, p.x, t, p.name).lon", "path.poses[2].pose.position.x",
        "odom.pose.covariance[p.n]", "quat_yaw(odom.pose.pose.orientation)",
        "(1 if b else 0)", "(1 if p.on else 0)",
    ]
)  # fmt: skip


def template(text, *parts):
    return st.tuples(*parts).map(lambda given: text.format(*given))


_numbers = st.recursive(
    _leaves,
    lambda inner: st.one_of(
        template("({} {} {})", inner, st.sampled_from(["+", "-", "*", "/", "//", "%"]), inner),
        template("({} ** {})", inner, st.sampled_from(["2", "-1", "0.5", "0", "16"])),
        template("(-{})", inner),
        template("({} if {} < {} else {})", inner, inner, inner, inner),
        template("msg.ranges[{}]", inner),
        template("fn.double({})", inner),
        template("[{}, 2, t][1]", st.sampled_from(["7", "p.x", "-t"])),
        *(
            template(f"{name}({', '.join(['{}'] * count)})", *[inner] * count)
            for name, builtin in BUILTINS.items()
            for count in range(1, 6)
            if not builtin.draws and isinstance(builtin.result([FLOAT] * count), Number)
        ),
    ),
    max_leaves=10,
)
_booleans = st.one_of(
    st.sampled_from(["b", "p.on", "true", "(p.name == 'a')", "(p.name != state.tracks['a'].name)"]),
    template("({} {} {})", number, st.sampled_from(["<", "<=", "==", "!=", ">=", ">"]), number),
    template("({} < {} <= {})", number, number, number),
    template("({} {} {})", boolean, st.sampled_from(["and", "or", "==", "!="]), boolean),
    template("(not {})", boolean),
    template("is_finite({})", number),
    template("fn.twice_far({})", number),
    template("in_polygon({}, {}, [[0, 0], [2, 0], (1.5, 3)])", number, number),
    template("({} if {} else {})", boolean, boolean, boolean),
)


def compiled(text, scope):
    """The expression, or None where random nesting went beyond the bounds."""
    try:
        return compile_expression(text, scope, elements=9)
    except ExpressionError as error:
        if not any(bound in str(error) for bound in ("deeper than", "more than", "at most")):
            raise
        return None


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


@given(number | boolean, environments())
def test_every_sentence_gives_a_value_of_its_type_whatever_the_data(text, env):
    expression = compiled(text, LOOP)
    if expression is not None:
        assert_is_value(expression(env), expression, len(env["r"]))


@given(number, environments())
def test_a_function_is_the_text_that_it_stands_for(text, env):
    call, body = compiled(f"fn.double({text})", LOOP), compiled(f"({text}) + ({text})", LOOP)
    if call is not None and body is not None:
        assert (call.type, call.vector, call.names) == (body.type, body.vector, body.names)
        np.testing.assert_array_equal(call(env), body(env))


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


# Anything at all.

HOSTILE_LEAVES = [
    *NAMES, *VECTORS, *CONSTANTS, *BUILTINS, "fn", "fn.double", "fn.far", "rng", "_x", "None",
    "True", "...", "1j", "b'x'", "'x'", "''", "1e309", "10**9", "__import__", "eval", "exec",
    "open", "getattr", "type", "object",
    "msg.ranges", "msg.intensities", "msg.header", "p.name", "state.tracks",
    "path.poses", "-1", "0", "3", "'{0.__class__}'", "9" * 40,
]  # fmt: skip
HOSTILE_SHAPES = [
    "{}.{}", "{}[{}]", "{}({})", "{}({}, {})", "{}({}={})", "{}(*{})", "{}(**{})", "{}[{}:{}]",
    "[{}, {}]", "({}, {})", "{{{}: {}}}", "{{{}}}", "[{} for x in {}]", "({} for x in {})",
    "(lambda: {})", "(lambda x: {})({})", "({} if {} else {})", "({} and {})", "(not {})", "(-{})",
    "(~{})", "({} + {})", "({} * {})", "({} % {})", "({} ** {})", "({} << {})", "({} @ {})",
    "({} & {})", "({} < {})", "({} == {})", "({} in {})", "({} is {})", "(x := {})", "(yield {})",
    "(await {})", "f'{{{}}}'", "{}.__class__", "{}.__class__.__mro__[1].__subclasses__()",
    "{}.__dict__", "{}.ranges.ctypes", "{}.tobytes()", "{}.format({})", "min({}, {})", "len({})",
    "nearest({}, {}, {}, {})", "quat_yaw({})", "uniform({}, {})", "bernoulli({})",
    "in_polygon({}, {}, {})", "fn.double({})", "fn.far({}, {})",
]  # fmt: skip
anything = st.recursive(
    st.sampled_from(HOSTILE_LEAVES),
    lambda inner: st.sampled_from(HOSTILE_SHAPES).flatmap(
        lambda shape: template(shape, *[inner] * (shape.replace("{{", "").count("{}")))
    ),
    max_leaves=8,
)
soup = st.lists(
    st.sampled_from([*HOSTILE_LEAVES, *" .,:;()[]{}+-*/%<>=!'\"\\\n\0#@_", " if ", " else ", "**"])
    | st.characters(),
    max_size=30,
).map("".join)


def refused_or_of_the_value_types(text, env):
    try:
        expression = compile_expression(text, LOOP)
    except ExpressionError:
        return
    assert_is_value(expression(env), expression, len(env["r"]))


@given(st.text() | soup, environments())
def test_no_text_gives_anything_but_a_value_or_a_refusal(text, env):
    refused_or_of_the_value_types(text, env)


@given(anything, environments())
def test_no_tree_gives_anything_but_a_value_or_a_refusal(text, env):
    refused_or_of_the_value_types(text, env)


SAMPLES = {
    ast.BoolOp: "p.on and p.on", ast.NamedExpr: "(x := 1)", ast.BinOp: "1 + 2",
    ast.UnaryOp: "-1", ast.Lambda: "lambda: 1", ast.IfExp: "1 if p.on else 2", ast.Dict: "{}",
    ast.Set: "{1}", ast.ListComp: "[1 for x in [1]]", ast.SetComp: "{1 for x in [1]}",
    ast.DictComp: "{1: 1 for x in [1]}", ast.GeneratorExp: "(1 for x in [1])",
    ast.Await: "await t", ast.Yield: "(yield)", ast.YieldFrom: "(yield from t)",
    ast.Compare: "1 < 2", ast.Call: "abs(1)", ast.FormattedValue: "f'{t}'",
    ast.JoinedStr: "f'a'", ast.Constant: "1", ast.Attribute: "p.x", ast.Subscript: "msg.ranges[0]",
    ast.Starred: "min(*[1, 2])", ast.Name: "t", ast.List: "[1, 2]", ast.Tuple: "(1, 2)",
    ast.Slice: "msg.ranges[0:1]",
}  # fmt: skip
LANGUAGE = {
    ast.BoolOp, ast.BinOp, ast.UnaryOp, ast.IfExp, ast.Compare, ast.Call, ast.Constant,
    ast.Attribute, ast.Subscript, ast.Name, ast.List, ast.Tuple,
}  # fmt: skip


@pytest.mark.parametrize("node", SAMPLES, ids=lambda node: node.__name__)
def test_every_kind_of_python_expression_is_of_the_language_or_refused(node):
    assert any(isinstance(part, node) for part in ast.walk(ast.parse(SAMPLES[node])))
    if node in LANGUAGE:
        compile_expression(SAMPLES[node], LOOP)
    else:
        with pytest.raises(ExpressionError, match="is not of the language"):
            compile_expression(SAMPLES[node], LOOP)


SYNTAX = "expected numbers, texts, names"  # after what Python says
REFUSED = {
    "msg.__class__": "'__class__' is private",
    "_x": "'_x' is private",
    "__import__('os').system('id')": "only built-ins and fn.<name> can be called",
    "msg.ranges.tobytes()": "only built-ins and fn.<name> can be called",
    "exec('1')": "'exec' is no built-in: abs, min",
    "msg.ranges.size": "array of number has no fields",
    "msg.rnages": "sensor_msgs/msg/LaserScan has no field 'rnages'; it has header, angle_min",
    "speed": "'speed' is unknown; known are msg, odom",
    "rng": "'rng' is unknown",
    "p": None,
    "t + p.name": "Column 1 of 't \\+ p.name': expected numbers, found text",
    "t < p.name": "number does not go with text",
    "p.name < 'a'": "can only be compared by == and !=",
    "msg == msg": "cannot be compared",
    "p.on + 1": "expected numbers, found boolean",
    "t and p.on": "expected booleans, found number",
    "1 if t else 2": "Column 6 .* expected booleans",
    "t if p.on else p.name": "number does not go with text",
    "p.name if b else 'a'": "the condition must be one boolean",
    "msg[0]": "has no element",
    "msg.ranges[p.name]": "has no element \\[text\\]",
    "path.poses[i].pose": "the index must be one number",
    "quat_yaw(odom.pose)": "quat_yaw\\(quaternion\\) cannot take \\(geometry_msgs",
    "nearest(state.tracks, r, t, 'a').lat": "takes one value, not one per element",
    "min(t)": "min\\(x, y, ...\\) cannot take \\(number\\)",
    "abs(x=1)": "given by position",
    "[1, 'a']": "a list has numbers",
    "[r, 1][0]": "a list has numbers",
    "[]": "a list has numbers",
    "[msg.ranges, msg.intensities]": "a list has numbers",
    "[path.poses, path.poses]": "a list has numbers",
    "[[[1]]]": "a list has numbers",
    "[[1, 2], [3]]": "a list has numbers",
    "t ** t": "an exponent must be a constant from -16 to 16",
    "9 ** 9 ** 9": "an exponent must be a constant",
    "2 ** 17": "an exponent must be a constant",
    "2 ** True": "expected numbers",
    "1e400": "must be finite",
    "9223372036854775808": "less than 2\\*\\*63",
    "None": "NoneType is not of the language",
    "1j": "complex is not of the language",
    "b'x'": "bytes is not of the language",
    "fn.double": "is called: fn.double",
    "fn.nothing(1)": "fn.nothing is unknown; known are double, far, twice_far",
    "fn.double(1, 2)": "expected the arguments \\(x\\), found 2",
    "fn.double(p.name)": "Column 1 of 'x \\+ x': expected numbers, found text",
    "1 +": SYNTAX,
    "t; t": SYNTAX,
    "'\\d' == 'd'": SYNTAX,
    "1if p.on else 2": SYNTAX,
    "é + speed": "'é' is unknown",
    "p.name == 'é' and speed": "Column 19 .*'speed' is unknown",
    "": SYNTAX,
    "x\0": SYNTAX,
    "\ud800": SYNTAX,
    "'" + "a" * 257 + "' == p.name": "a text has at most 256 characters",
    "1 + " * 250 + "1": "has 1001 characters; at most 1000",
    "-" * 900 + "1": "nested deeper than 40",
    "(" * 400 + "1" + ")" * 400: SYNTAX,
    "not " * 200 + "p.on": "nested deeper than 40",
    "msg" + ".header" * 120: "nested deeper than 40",
    "msg.ranges" + "[0]" * 200: "nested deeper than 40",
    "1" + " + 1" * 100: "nested deeper than 40",
    "msg.ranges" + "[0" * 250 + "]" * 250: SYNTAX,
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: ascii(text)[:40])
def test_a_refusal_says_where_what_and_what_was_expected(text):
    if REFUSED[text] is None:
        assert compile_expression(text, LOOP).type is NAMES[text]
        return
    with pytest.raises(ExpressionError, match=REFUSED[text]):
        compile_expression(text, LOOP)


# Functions.


@pytest.mark.parametrize("ring", [("f",), ("f", "g"), ("f", "g", "h")])
def test_functions_that_call_each_other_in_a_ring_are_refused_unused(ring):
    functions = {
        name: Function(("x",), f"fn.{ring[(k + 1) % len(ring)]}(x)") for k, name in enumerate(ring)
    }
    with pytest.raises(ExpressionError, match="cannot call themselves, but fn.* calls fn."):
        Scope({}, functions)


def test_functions_that_double_each_other_are_refused_before_they_cost_anything():
    functions = {"f0": Function(("x",), "x + x")}
    for k in range(1, 64):
        functions[f"f{k}"] = Function(("x",), f"fn.f{k - 1}(x) + fn.f{k - 1}(x)")
    with pytest.raises(ExpressionError, match=f"nested deeper|more than {MAX_OPERATIONS}"):
        compile_expression("fn.f63(1)", Scope({}, functions))
    with pytest.raises(ExpressionError, match=f"more than {MAX_OPERATIONS} operations"):
        compile_expression("fn.f12(1)", Scope({}, functions))


def test_depth_counts_through_functions():
    functions = {"f0": Function(("x",), "-" * 20 + "x")}
    for k in range(1, 5):
        functions[f"f{k}"] = Function(("x",), "-" * 10 + f"fn.f{k - 1}(x)")
    compile_expression("fn.f1(1)", Scope({}, functions))
    with pytest.raises(ExpressionError, match=f"nested deeper than {MAX_DEPTH}"):
        compile_expression("fn.f4(1)", Scope({}, functions))


def test_a_function_does_not_see_what_is_local_to_its_caller():
    scope = Scope(NAMES, {"leak": Function((), "r + 1")}, VECTORS, ("r",))
    with pytest.raises(ExpressionError, match="'r' is unknown"):
        compile_expression("fn.leak()", scope)


def test_a_parameter_hides_a_name_of_the_scenario_in_its_function_only():
    scope = Scope(NAMES, {"same": Function(("t",), "t")})
    assert compile_expression("fn.same(5) + t", scope)({"t": 2.0}) == 7.0


def test_calls_with_other_arguments_are_told_apart():
    scope = Scope(
        {"t": FLOAT},
        {
            "inc": Function(("x",), "x + 1"),
            "two": Function(("x",), "fn.inc(x) * 10 + fn.inc(x + 1)"),
        },
    )
    assert compile_expression("fn.two(t) + fn.two(t + 5)", scope)({"t": 0.0}) == 12.0 + 67.0


def test_a_function_cannot_draw():
    with pytest.raises(ExpressionError, match="a function cannot draw"):
        Function((), "1 + uniform(0, 1)")


@pytest.mark.parametrize(
    "name", ["__class__", "_x", "rng", "fn", "min", "true", "lambda", "a b", "", "1x", "a.b"]
)
def test_names_that_are_private_reserved_or_no_names_cannot_be_given(name):
    with pytest.raises(ExpressionError, match="is no name|is taken"):
        Scope({}, locals={name: FLOAT})
    with pytest.raises(ExpressionError, match="is no name|is taken"):
        Function((name,), "1")


def test_a_name_is_given_once_and_vectors_are_local_numbers():
    with pytest.raises(ExpressionError, match="'t' is taken"):
        Scope({"t": FLOAT}, locals={"t": FLOAT})
    with pytest.raises(ExpressionError, match="'x' is taken"):
        Function(("x", "x"), "1")
    with pytest.raises(ExpressionError, match="'name' is no local number"):
        Scope({}, locals={"name": Text(8)}, vectors=("name",))


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
    scan = message_type(SCAN).missing
    scan.ranges = ranges
    index = data.draw(hnp.arrays(np.int64, 6, elements=st.integers(-3, 12)))
    found = compile_expression("msg.ranges[i]", LOOP)({"msg": scan, "i": index})
    padded = np.concatenate([np.full(3, np.nan), ranges, np.full(13, np.nan)])
    np.testing.assert_array_equal(found, padded[index + 3])


def test_an_index_between_two_elements_is_that_of_the_first():
    env = {"msg": message_type(SCAN).missing, "t": 1.9}
    env["msg"].ranges = np.array([5.0, 6.0, 7.0], np.float32)
    assert compile_expression("msg.ranges[t]", GLOBAL)(env) == 6.0
    assert math.isnan(compile_expression("msg.ranges[-0.5]", GLOBAL)(env))


def test_what_is_missing_reads_as_nan_zero_false_and_the_empty_text():
    env = {"path": message_type("nav_msgs/msg/Path").missing, "state": {"tracks": {}}}
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


@pytest.mark.parametrize("msgtype", sorted(typestore().fielddefs))
def test_every_field_of_every_message_can_be_read_with_its_type(msgtype):
    kind = message_type(msgtype)
    scope, env = Scope({"msg": kind}), {"msg": kind.missing}
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
    np.testing.assert_array_equal(together(env), Draws(1, 2).uniform(3, 4, 5))
    assert compile_expression("uniform(0, 1)", GLOBAL)(env) == Draws(1, 2).uniform(3, 4, 1)[0]


def test_two_draws_in_one_expression_are_independent():
    draws = functools.partial(Draws(1, 2).generator, 3, 4)
    difference = compile_expression("gauss(0, 1) - gauss(0, 1)", GLOBAL)({"rng": draws})
    assert difference == (
        Draws(1, 2).generator(3, 4, 0).standard_normal()
        - Draws(1, 2).generator(3, 4, 1).standard_normal()
    )


# Cost.


@pytest.mark.parametrize("elements", [1, 360, 10_000])
def test_only_what_is_worked_out_per_element_costs_per_element(elements):
    def cost(text):
        return compile_expression(text, LOOP, elements=elements).cost

    assert cost("sqrt(t)") == 2
    assert cost("sqrt(r)") == 2 * elements
    assert cost("in_polygon(r, t, [[0, 0], [1, 0], [1, 1], [0, 1]])") >= 4 * elements
    assert cost("nearest(state.tracks, t, t, 'a').lat") >= 16
