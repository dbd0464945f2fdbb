"""The features of a recording do not depend on the tool that wrote it."""

import math

import pytest
from backports import zstd
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from oracle_pipeline.bags.types import deserialize, serialize, typestore
from oracle_pipeline.features import build_manager, measure
from oracle_pipeline.features.extraction import only_robot
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.bags.makers import McapChannel, write_channels, write_db3
from tests.oracle_pipeline.features.conftest import START_NS, drive, write_bag

MANAGER = build_manager()
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
DRIVE = [each for each in drive() if each[1] in ("/odom", "/plan", "/scan", "/scan_fakeobject")]
TYPES = {topic: message.__msgtype__ for _, topic, message in DRIVE}
MESSAGES = [
    (topic, START_NS + round(seconds * 1e9), serialize(message, TYPES[topic]))
    for seconds, topic, message in DRIVE
]


def ros1(topic, data):
    return bytes(ROS2.cdr_to_ros1(data, TYPES[topic]))


def big_endian(topic, data):
    msgtype = TYPES[topic]
    return bytes(
        typestore().serialize_cdr(deserialize(data, msgtype), msgtype, little_endian=False)
    )


def ros1_bag(path):
    with Writer1(path) as bag:
        connections = {t: bag.add_connection(t, each, typestore=ROS1) for t, each in TYPES.items()}
        for topic, stamp_ns, data in MESSAGES:
            bag.write(connections[topic], stamp_ns, ros1(topic, data))


def ros1_in_mcap(path):
    channels = []
    for topic, msgtype in TYPES.items():
        own = [each for each in MESSAGES if each[0] == topic]
        text, _ = ROS1.generate_msgdef(msgtype, ros_version=1)
        channels.append(
            McapChannel(
                topic, msgtype.replace("/msg/", "/"), text, [ros1(topic, d) for _, _, d in own],
                "ros1msg", "ros1", stamps_ns=[stamp_ns for _, stamp_ns, _ in own],
            )
        )  # fmt: skip
    write_channels(path, channels)


def names_of_types_of_ros1(path):
    write_db3(path, MESSAGES, types={t: each.replace("/msg/", "/") for t, each in TYPES.items()})


def names_without_slash(path):
    types = {topic.lstrip("/"): each for topic, each in TYPES.items()}
    write_db3(path, [(topic.lstrip("/"), *rest) for topic, *rest in MESSAGES], types=types)


def messages_of_the_other_byte_order(path):
    write_db3(path, [(t, stamp, big_endian(t, data)) for t, stamp, data in MESSAGES], types=TYPES)


def compressed_messages(path):
    write_db3(path, [(t, stamp, zstd.compress(data)) for t, stamp, data in MESSAGES], types=TYPES)


WRITERS = {
    "a.bag": ros1_bag, "b.mcap": ros1_in_mcap, "c.db3": names_of_types_of_ros1,
    "d.db3": names_without_slash, "e.db3": messages_of_the_other_byte_order,
    "f.db3": compressed_messages,
}  # fmt: skip


def features_of(path):
    """Return the features of a recording, without those of the bytes of its messages."""
    with open_run(path) as run:
        assert all(name.startswith("/") for name in only_robot(run).bag.topics)
        measured = measure(run, MANAGER)
    (row,) = measured.run.rows()
    assert not [note for note in measured.notes if "not decoded" in note]
    ours = {name: each for name, each in row.items() if "." in name and not math.isnan(each)}
    return {name: each for name, each in ours.items() if "byte" not in name and "zlib" not in name}


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    path = tmp_path_factory.mktemp("ours") / "bag"
    write_bag(path, DRIVE)
    return features_of(path)


@pytest.mark.parametrize("name", WRITERS)
def test_who_wrote_a_recording_makes_no_difference(name, expected, tmp_path):
    WRITERS[name](tmp_path / name)
    assert features_of(tmp_path / name) == expected
    assert expected["contextual.total_turning"] > 1.0
