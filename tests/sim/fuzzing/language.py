"""A scope with every kind of name, environments for it, and random expressions over it."""

import functools
import math
from collections.abc import Mapping

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import message_class
from sim.fuzzing.expressions import compile_expression
from sim.fuzzing.functions import BUILTINS
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
    missing,
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

reals = st.floats() | st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan, 1.0])
wholes = st.integers(-(2**63), 2**63 - 1) | st.integers(-3, 9)
texts = st.text(max_size=8)
lengths = st.integers(0, 9)


@st.composite
def environments(draw):
    """An environment with arbitrary values for expressions."""
    scan = missing(message_type(SCAN))
    scan.range_min, scan.range_max = draw(reals), draw(reals)
    scan.ranges = draw(hnp.arrays(np.float32, lengths, elements=st.floats(width=32)))
    scan.intensities = draw(hnp.arrays(np.float32, lengths))
    path = missing(message_type("nav_msgs/msg/Path"))
    path.poses = [missing(message_type("geometry_msgs/msg/PoseStamped"))] * draw(lengths)
    rows = st.fixed_dictionaries({"lat": reals, "lon": reals, "name": texts})
    n = draw(lengths)
    return {
        "msg": scan,
        "odom": missing(message_type("nav_msgs/msg/Odometry")),
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
