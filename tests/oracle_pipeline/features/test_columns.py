from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.features.engine.columns import Columns, SerializedMessages
from tests.oracle_pipeline.features.rows import batch_of, columns_of

#: Types with all that a field can be: nested, repeated, of fixed and of any length.
TYPES = (
    "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/JointState",
    "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Path", "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Imu", "nav_msgs/msg/OccupancyGrid",
    "sensor_msgs/msg/Range", "sensor_msgs/msg/PointCloud2", "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/msg/Float64MultiArray", "action_msgs/msg/GoalStatusArray", "std_msgs/msg/Bool",
    "nav2_msgs/msg/BehaviorTreeLog", "visualization_msgs/msg/MarkerArray",
)  # fmt: skip
_WHOLE = {"int": -(2**31), "uint": 0}
_SIZE = st.integers(0, 3)


def content(draw: st.DrawFn, kind: Any) -> Any:
    """Draw a value of a field."""
    of, what = kind
    if of == Nodetype.NAME:
        fields = typestore().fielddefs[what][1]
        return message_class(what)(*(content(draw, each) for _, each in fields))
    if of == Nodetype.BASE:
        name = what[0]
        if name == "string":
            return draw(st.text(max_size=9).filter(lambda text: "\0" not in text))
        if name.startswith("float"):
            return draw(st.floats(width=int(name[5:]), allow_nan=False))
        return draw(st.booleans()) if name == "bool" else draw(st.integers(0, 127))
    element, count = what
    size = count if of == Nodetype.ARRAY else draw(_SIZE)
    values = [content(draw, element) for _ in range(size)]
    if element[0] != Nodetype.BASE or element[1][0] == "string":
        return values
    dtype = {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
    return np.array(values, dtype=dtype)


@st.composite
def some_messages(draw: st.DrawFn) -> list[Any]:
    kind = Nodetype.NAME, draw(st.sampled_from(TYPES))
    return [content(draw, kind) for _ in range(draw(st.integers(1, 4)))]


def check(columns: Columns, decoded: list[Any]) -> None:
    """Compare all fields of columns with those of the decoded messages."""
    msgtype = decoded[0].__msgtype__
    for name, (of, what) in typestore().fielddefs[msgtype][1]:
        found, expected = getattr(columns, name), [getattr(each, name) for each in decoded]
        if of == Nodetype.NAME:
            check(found, expected)
        elif isinstance(found, Columns):
            assert found.owners.tolist() == [i for i, each in enumerate(expected) for _ in each]
            if flat := [each for of_message in expected for each in of_message]:
                check(found, flat)
        elif of == Nodetype.BASE:
            assert found.tolist() == expected
        elif what[0][1][0] == "string":
            assert found.tolist() == [tuple(each) for each in expected]
        else:
            assert len(found) == len(expected)
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_array_equal(one, other)


@given(some_messages())
@settings(max_examples=60, deadline=None)
def test_columns_have_what_decoding_gives(messages):
    batch = batch_of(*messages)
    assert batch.whole.all()
    msgtype = messages[0].__msgtype__
    check(batch.columns(), [typestore().deserialize_cdr(data, msgtype) for data in batch.data])


@given(
    st.lists(st.lists(st.sampled_from(["map", "map", "odom_1"]), max_size=9), min_size=1), st.data()
)
def test_elements_of_one_length_and_of_several_are_found(frames, data):
    def make(name, *fields):
        return message_class(name)(*fields)

    header = make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", 0, 0), "x")
    pair = make("diagnostic_msgs/msg/KeyValue", "key", "a")
    messages = [
        make("diagnostic_msgs/msg/DiagnosticArray", header, [
            make("diagnostic_msgs/msg/DiagnosticStatus", 1, name, "", "", [pair] * len(name))
            for name in names
        ])
        for names in frames
    ]  # fmt: skip
    batch = batch_of(*messages)
    check(batch.columns(), messages)
    cut = batch.data[0][: data.draw(st.integers(4, len(batch.data[0])))]
    msgtype = messages[0].__msgtype__
    odd = SerializedMessages([cut, *batch.data], typestore(), msgtype, is_cdr=True)
    assert odd.whole.tolist() == [decodes(cut, msgtype), *[True] * len(messages)]


def decodes(data: bytes, msgtype: str) -> bool:
    try:
        typestore().deserialize_cdr(data, msgtype)
    except Exception as error:
        return "codec" in str(error)  # strings are not compared
    return True


@given(some_messages(), st.data())
@settings(max_examples=60, deadline=None)
def test_a_message_is_complete_exactly_if_it_can_be_decoded(messages, data):
    msgtype = messages[0].__msgtype__
    whole = serialize(messages[0], msgtype)
    cut = whole[: data.draw(st.integers(0, len(whole)))]
    longer = whole + bytes(data.draw(st.integers(0, 9)))
    at = data.draw(st.integers(4, max(4, len(whole) - 1)))
    changed = bytearray(whole)
    if at < len(whole):
        changed[at] ^= data.draw(st.integers(1, 255))
    for odd in (cut, longer, bytes(changed)):
        batch = SerializedMessages([whole, odd], typestore(), msgtype, is_cdr=True)
        assert batch.whole.tolist() == [True, decodes(odd, msgtype)]


def test_a_missing_field_is_an_error():
    with pytest.raises(AttributeError, match="no field 'speed'"):
        _ = columns_of(message_class("std_msgs/msg/Bool")(True)).speed
