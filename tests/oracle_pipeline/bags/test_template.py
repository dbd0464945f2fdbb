"""Templates against the type store's own serialisation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class, serialize

IMU = "sensor_msgs/msg/Imu"
TF = "tf2_msgs/msg/TFMessage"
JOINTS = "sensor_msgs/msg/JointState"

finite = st.floats(allow_nan=False, width=64)
frames = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=20)
stamps = st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))


def header(stamp, frame):
    return message_class("std_msgs/msg/Header")(
        message_class("builtin_interfaces/msg/Time")(*stamp), frame
    )


def imu(stamp, frame, orientation, turning):
    quaternion, vector = (
        message_class(f"geometry_msgs/msg/{n}") for n in ("Quaternion", "Vector3")
    )
    covariance = np.arange(9.0)
    return message_class(IMU)(
        header(stamp, frame),
        quaternion(*orientation),
        covariance,
        vector(*turning),
        covariance,
        vector(0.0, 0.0, 9.8),
        covariance,
    )


def transforms(stamp, frame, numbers):
    vector, quaternion, transform, stamped = (
        message_class(f"geometry_msgs/msg/{name}")
        for name in ("Vector3", "Quaternion", "Transform", "TransformStamped")
    )
    moved = transform(vector(*numbers[:3]), quaternion(*numbers[3:]))
    first = stamped(header((1, 2), "a"), "bc", moved)
    return message_class(TF)([first, stamped(header(stamp, frame), frame, moved)])


numbers = st.tuples(*[finite] * 7)


@given(stamps, frames, numbers)
def test_a_filled_template_is_the_message_serialised(stamp, frame, row):
    template = Template(imu((0, 0), frame, [0.0] * 4, [0.0] * 3), IMU, (*STAMP, "orientation"))
    assert template.data(*stamp, row[:4]) == serialize(imu(stamp, frame, row[:4], [0.0] * 3), IMU)


@given(st.lists(st.tuples(stamps, numbers), min_size=1, max_size=5), frames)
def test_rows_are_messages_one_after_the_other(messages, frame):
    template = Template(
        imu((0, 0), frame, [0.0] * 4, [0.0] * 3), IMU, (*STAMP, "orientation", "angular_velocity")
    )
    rows = template.rows(len(messages))
    for field, column in zip(
        STAMP, zip(*(stamp for stamp, _ in messages), strict=True), strict=True
    ):
        rows[field] = column
    rows["orientation"] = [row[:4] for _, row in messages]
    rows["angular_velocity"] = [row[4:] for _, row in messages]
    assert [row.tobytes() for row in rows] == [
        serialize(imu(stamp, frame, row[:4], row[4:]), IMU) for stamp, row in messages
    ]


@given(stamps, frames, numbers)
def test_a_field_may_lie_in_an_element_of_a_sequence(stamp, frame, row):
    where = "transforms.1"
    fields = [f"{where}.{part}" for part in (*STAMP, "transform")]
    template = Template(transforms((0, 0), frame, [0.0] * 7), TF, fields)
    filled = template.data(*stamp, row)
    # The first transform keeps the prototype's numbers.
    expected = transforms(stamp, frame, row)
    expected.transforms[0] = transforms((0, 0), frame, [0.0] * 7).transforms[0]
    assert filled == serialize(expected, TF)


@given(st.lists(finite, min_size=1, max_size=4))
def test_a_sequence_of_numbers_keeps_its_length(positions):
    def state(values):
        return message_class(JOINTS)(
            header((3, 4), "x"), ["left"], np.array(values), np.zeros(0), np.zeros(0)
        )

    template = Template(state([0.0] * len(positions)), JOINTS, ("position",))
    assert template.data(positions) == serialize(state(positions), JOINTS)


@pytest.mark.parametrize("field", ["header.frame_id", "header", "orientatio", "orientation.x.y"])
def test_a_field_that_is_not_made_of_numbers_of_one_type_is_refused(field):
    with pytest.raises(BagError, match=field):
        Template(imu((0, 0), "f", [0.0] * 4, [0.0] * 3), IMU, (field,))
