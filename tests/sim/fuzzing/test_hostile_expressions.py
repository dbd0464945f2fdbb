"""Any text gives a value of the language or is refused with its place."""

import ast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fuzzing.expressions import compile_expression
from sim.fuzzing.functions import BUILTINS, CONSTANTS
from sim.fuzzing.grammar import ExpressionError
from tests.sim.fuzzing.language import LOOP, NAMES, VECTORS, assert_is_value, environments, template

pytestmark = [pytest.mark.usefixtures("quiet"), pytest.mark.slow]


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
def test_an_error_has_place_found_and_expected_value(text):
    if REFUSED[text] is None:
        assert compile_expression(text, LOOP).type is NAMES[text]
        return
    with pytest.raises(ExpressionError, match=REFUSED[text]):
        compile_expression(text, LOOP)
