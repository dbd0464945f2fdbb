import numpy as np
import pytest

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.features.engine.message_layout import MessageLayout

FIRST_ARRAYS = {  # the field of each type that the layout must find
    "sensor_msgs/msg/LaserScan": "ranges",
    "sensor_msgs/msg/JointState": "position",
    "std_msgs/msg/Float64MultiArray": "data",
}


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
            array = layout.array(message.data)
            assert layout.has_array == (field is not None)
            if field is None:
                assert array is None
            else:
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
@pytest.mark.parametrize("little_endian", [True, False])
def test_arrays_are_found_behind_texts_and_structures(label, little_endian, bag_of):
    message = multi_array(label, [1.0, np.nan, -3.0])
    with BagReader(bag_of([(0.0, "/a", message)])) as bag:
        data = typestore().serialize_cdr(message, message.__msgtype__, little_endian=little_endian)
        array = MessageLayout(bag, "/a").array(bytes(data))
    np.testing.assert_array_equal(array, [1.0, np.nan, -3.0])


@pytest.mark.parametrize("little_endian", [True, False])
def test_stamps_are_read_in_either_byte_order(little_endian, bag_of, messages):
    message = messages.scan(7, [1.0])
    with BagReader(bag_of([(0.0, "/scan", message)])) as bag:
        data = typestore().serialize_cdr(message, message.__msgtype__, little_endian=little_endian)
        assert MessageLayout(bag, "/scan").header_stamp_ns(bytes(data)) == 7_000_000_000


def test_broken_bytes_have_no_array(bag_of, messages):
    message = messages.scan(0, np.arange(20.0))
    data = serialize(message, message.__msgtype__)
    with BagReader(bag_of([(0.0, "/scan", message)])) as bag:
        layout = MessageLayout(bag, "/scan")
        assert layout.array(data).tolist() == list(range(20))
        for end in range(len(data) - 24):  # cut off before the last ranges
            assert layout.array(data[:end]) is None
        assert layout.array(data[:12] + b"\xff" * 4 + data[16:]) is None  # a text without end


def test_an_empty_array_is_an_array(bag_of):
    with BagReader(bag_of([(0.0, "/a", message := multi_array("ab", []))])) as bag:
        array = MessageLayout(bag, "/a").array(serialize(message, message.__msgtype__))
    assert array is not None
    assert array.size == 0
