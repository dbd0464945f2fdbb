from typing import Any

import numpy as np
import pytest

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.features.engine.columns import SerializedMessages
from oracle_pipeline.features.engine.message_layout import MessageLayout

FIRST_ARRAYS = {  # the field of each type that the layout must find
    "sensor_msgs/msg/LaserScan": "ranges",
    "sensor_msgs/msg/JointState": "position",
    "std_msgs/msg/Float64MultiArray": "data",
}


def first_array(bag: BagReader, topic: str, data: bytes) -> Any:
    """Return the first array of a message; None if it has none."""
    msgtype = bag.topics[topic].msgtype
    message = SerializedMessages([data], bag.typestore(msgtype), msgtype, is_cdr=True)
    found = message.columns().first_array
    return None if found is None else found[0]


def test_layouts_agree_with_the_decoder_on_real_bags(foreign_bag):
    compared = 0
    with BagReader(foreign_bag) as bag:
        layouts = {topic: MessageLayout(bag, topic) for topic in bag.topics}
        for message in bag.messages():
            decoded, layout = bag.deserialize(message), layouts[message.topic]
            if hasattr(decoded, "header"):
                stamp = decoded.header.stamp
                stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
                assert layout.header_stamp_ns(message.data) == stamp_ns
            else:
                assert layout.header_stamp_ns(message.data) is None
            field = FIRST_ARRAYS.get(bag.topics[message.topic].msgtype)
            array = first_array(bag, message.topic, message.data)
            assert layout.has_array == (array is not None) == (field is not None)
            if field is not None:
                np.testing.assert_array_equal(array, getattr(decoded, field))
                compared += 1
    assert compared > 0


def multi_array(label: str, numbers: list[float]) -> object:
    layout, dimension = (
        message_class(f"std_msgs/msg/MultiArray{name}") for name in ("Layout", "Dimension")
    )
    content = layout([dimension(label, 1, 2), dimension(label + "x", 3, 4)], 5)
    return message_class("std_msgs/msg/Float64MultiArray")(content, np.array(numbers))


@pytest.mark.parametrize("label", ["", "a", "ab", "abc", "abcd"])  # each another alignment
@pytest.mark.parametrize("numbers", [[], [1.0, np.nan, -3.0]])
def test_arrays_are_found_behind_texts_and_structures(label, numbers, bag_of):
    message = multi_array(label, numbers)
    with BagReader(bag_of([(0.0, "/a", message)])) as bag:
        array = first_array(bag, "/a", serialize(message, message.__msgtype__))
    np.testing.assert_array_equal(array, numbers)


@pytest.mark.parametrize("little_endian", [True, False])
def test_stamps_are_read_in_either_byte_order(little_endian, bag_of, messages):
    message = messages.scan(7, [1.0])
    with BagReader(bag_of([(0.0, "/scan", message)])) as bag:
        data = typestore().serialize_cdr(message, message.__msgtype__, little_endian=little_endian)
        assert MessageLayout(bag, "/scan").header_stamp_ns(bytes(data)) == 7_000_000_000
