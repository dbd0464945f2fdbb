import contextlib
import shutil
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader, content_hash, read_ground_truth
from oracle_pipeline.bags.types import (
    GROUND_TRUTH_TOPIC,
    GROUND_TRUTH_TYPE,
    message_class,
    serialize,
    typestore,
)
from oracle_pipeline.bags.writer import BagWriter

STRING = "std_msgs/msg/String"


def text(content: str) -> bytes:
    return serialize(message_class(STRING)(content), STRING)


def edit_metadata(bag: Path, change) -> None:
    file = bag / "metadata.yaml"
    metadata = yaml.safe_load(file.read_text("utf-8"))
    change(metadata["rosbag2_bagfile_information"])
    file.write_text(yaml.safe_dump(metadata), "utf-8")


def write_with_rosbags(path: Path, storage: str, mode: CompressionMode) -> None:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/chatter", STRING, typestore=typestore())
        for number in range(5):
            writer.write(connection, number, text(f"message {number}"))


def test_every_message_of_every_bag_at_hand_is_decoded(any_bag):
    with BagReader(any_bag) as bag:
        decoded = [bag.deserialize(message) for message in bag.messages()]
        assert len(decoded) == bag.message_count > 0
        stamps = [message.stamp_ns for message in bag.messages()]
    assert stamps == sorted(stamps)
    assert (bag.start_ns, bag.end_ns) == (stamps[0], stamps[-1])


def test_only_the_requested_topics_are_read(write_bag, tmp_path):
    with BagReader(write_bag(tmp_path / "bag")) as bag:
        assert {m.topic for m in bag.messages(["/clock", "/absent"])} == {"/clock"}
        assert list(bag.messages([])) == []


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE])
def test_compressed_files_read_like_others(storage, mode, tmp_path):
    write_with_rosbags(tmp_path / "bag", storage, mode)
    with BagReader(tmp_path / "bag") as bag:
        assert [bag.deserialize(m).data for m in bag.messages()][-1] == "message 4"


def test_compressed_messages_read_like_others(tmp_path):
    write_with_rosbags(tmp_path / "bag", "sqlite3", CompressionMode.MESSAGE)
    with BagReader(tmp_path / "bag") as bag:
        assert [bag.deserialize(m).data for m in bag.messages()][-1] == "message 4"


def test_a_split_bag_is_one_bag(tmp_path, write_bag):
    bag = write_bag(tmp_path / "bag")
    with BagReader(bag) as whole:
        expected = list(whole.messages())
    split = tmp_path / "split"
    split.mkdir()
    for part, messages in enumerate((expected[:13], expected[13:])):
        with BagWriter(tmp_path / f"part{part}") as writer:
            for name, topic in whole.topics.items():
                writer.add_topic(name, topic.msgtype, topic.qos)
            for message in messages:
                writer.write(*message)
        shutil.copy(tmp_path / f"part{part}" / f"part{part}_0.mcap", split / f"split_{part}.mcap")
    shutil.copy(bag / "metadata.yaml", split)
    files = ["split_0.mcap", "split_1.mcap"]
    edit_metadata(split, lambda metadata: metadata.update(relative_file_paths=files, files=[]))
    with BagReader(split) as read:
        assert list(read.messages()) == expected


def test_a_ros1_bag_reads_like_others(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    header = store.types["std_msgs/msg/Header"]
    stamped, time = "geometry_msgs/msg/PointStamped", store.types["builtin_interfaces/msg/Time"]
    with Writer1(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/point", stamped, typestore=store)
        for number in range(3):
            point = store.types["geometry_msgs/msg/Point"](float(number), 0.0, 0.0)
            message = store.types[stamped](header(number, time(number, 0), "map"), point)
            writer.write(connection, number, store.serialize_ros1(message, stamped))
    with BagReader(tmp_path / "old.bag") as bag:
        assert bag.topics["/point"].msgtype == stamped
        decoded = [bag.deserialize(message) for message in bag.messages()]
    assert [(m.header.seq, m.point.x) for m in decoded] == [(0, 0.0), (1, 1.0), (2, 2.0)]


@pytest.mark.parametrize("topic", [GROUND_TRUTH_TOPIC, "/innocent_name"])
def test_ground_truth_is_dropped_by_name_and_by_type(topic, tmp_path):
    time = message_class("builtin_interfaces/msg/Time")(1, 0)
    truth = message_class(GROUND_TRUTH_TYPE)(time, "/scan", 7, "noise", 0.1, "{}")
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(topic, GROUND_TRUTH_TYPE, [])
        writer.add_topic("/chatter", STRING, [])
        writer.write(topic, 5, serialize(truth, GROUND_TRUTH_TYPE))
        writer.write("/chatter", 6, text("hello"))
    with BagReader(tmp_path / "bag") as bag:
        assert list(bag.topics) == ["/chatter"]
        assert bag.message_count == 1
        assert {m.topic for m in bag.messages()} == {"/chatter"}
        assert {m.topic for m in bag.messages([topic, "/chatter"])} == {"/chatter"}
    assert [(stamp, m.index, m.operation) for stamp, m in read_ground_truth(tmp_path / "bag")] == [
        (5, 7, "noise")
    ]
    assert content_hash(tmp_path / "bag") == writer.content_hash


def test_the_name_of_ground_truth_is_enough_to_drop_it(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(GROUND_TRUTH_TOPIC, STRING, [])
        writer.write(GROUND_TRUTH_TOPIC, 5, text("malicious"))
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics == {}


def test_metadata_does_not_decide_what_is_read(write_bag, tmp_path):
    bag = write_bag(tmp_path / "bag")

    def other(metadata):
        metadata["message_count"] = 3
        metadata["duration"]["nanoseconds"] = 5
        (metadata["topics_with_message_count"]).pop()
        metadata["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"] = ""

    edit_metadata(bag, other)
    with BagReader(bag) as read:
        assert len(list(read.messages())) == read.message_count == 40
        assert (read.start_ns, read.end_ns) == (0, 1_900_000_000)
        assert [len(topic.qos) for topic in read.topics.values()] == [1, 2]


def test_a_file_that_is_no_bag_is_an_error(tmp_path):
    with pytest.raises(BagError, match=r"There is no bag .*absent"):
        BagReader(tmp_path / "absent")
    with pytest.raises(BagError, match=r"is not a bag: it holds no \.mcap"):
        BagReader(tmp_path)
    for name in ("empty.mcap", "empty.db3", "empty.bag", "empty.txt"):
        (tmp_path / name).touch()
        with pytest.raises(BagError, match=name):
            BagReader(tmp_path / name)


@pytest.mark.parametrize(
    "text", ["a: [1", "", "rosbag2_bagfile_information: 1", "&a [*a]", "[" * 99]
)
def test_broken_metadata_is_reported_and_loses_nothing(text, write_bag, tmp_path):
    bag = write_bag(tmp_path / "bag")
    (bag / "metadata.yaml").write_text(text)
    with BagReader(bag, strict=True) as read:
        assert len(list(read.messages())) == 40
        assert "metadata.yaml is not used" in read.notes[0]


@pytest.mark.parametrize(
    "name", ["../elsewhere.mcap", "/etc/passwd", "a/../../elsewhere.mcap", ".."]
)
def test_metadata_cannot_lead_out_of_the_folder(name, write_bag, tmp_path):
    bag = write_bag(tmp_path / "bag")
    (bag / "bag_0.mcap").rename(tmp_path / "elsewhere.mcap")
    edit_metadata(bag, lambda metadata: metadata.update(relative_file_paths=[name]))
    with pytest.raises(BagError, match="is not a bag: (it holds no|metadata.yaml names)"):
        BagReader(bag)


def test_a_link_cannot_lead_out_of_the_folder(write_bag, tmp_path):
    bag = write_bag(tmp_path / "bag")
    (bag / "bag_0.mcap").rename(tmp_path / "elsewhere.mcap")
    (bag / "bag_0.mcap").symlink_to(tmp_path / "elsewhere.mcap")
    with pytest.raises(BagError, match="out of the bag's folder"):
        BagReader(bag)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_damaged_bag_raises_bag_error_or_is_read_completely(storage, write_bag, tmp_path):
    bag = write_bag(tmp_path / "bag", storage)
    file = next(path for path in bag.iterdir() if path.stem == "bag_0")
    whole = file.read_bytes()

    @settings(max_examples=60)
    @given(st.data())
    def check(data):
        damaged = bytearray(whole)
        position = data.draw(st.integers(0, len(whole) - 1), "position")
        damaged[position] ^= data.draw(st.integers(1, 255), "flipped")
        file.write_bytes(damaged)
        with contextlib.suppress(BagError), BagReader(bag, strict=True) as read:
            assert len(list(read.messages())) == 40

    check()


def write_custom(path: Path, msgtype: str, definition: str, *values: object, **stored: str) -> None:
    """Write one message of a type that is defined here and, by default, in the bag."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(definition, msgtype))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            "/custom", msgtype, rihs01="RIHS01_0", msgdef=stored.get("msgdef", definition)
        )
        writer.write(connection, 0, store.serialize_cdr(store.types[msgtype](*values), msgtype))


def test_types_that_only_the_bag_knows_are_decoded(tmp_path):
    write_custom(tmp_path / "bag", "my_msgs/msg/Pair", "int32 a\nstring b\n", 3, "three")
    with BagReader(tmp_path / "bag") as bag:
        (message,) = bag.messages()
        assert bag.deserialize(message).b == "three"


def test_the_definition_in_the_bag_has_precedence(tmp_path):
    # Jazzy's form has one field more than Humble's.
    definition = (
        "builtin_interfaces/Time timestamp\nstring node_name\nuint16 uid\n"
        "string previous_status\nstring current_status\n"
        + "=" * 80
        + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    time = message_class("builtin_interfaces/msg/Time")(1, 2)
    msgtype = "nav2_msgs/msg/BehaviorTreeStatusChange"
    write_custom(tmp_path / "bag", msgtype, definition, time, "Spin", 9, "IDLE", "RUNNING")
    with BagReader(tmp_path / "bag") as bag:
        (message,) = bag.messages()
        assert bag.deserialize(message).uid == 9


def test_messages_of_unknown_type_are_raw_and_reported(tmp_path):
    write_custom(tmp_path / "bag", "my_msgs/msg/Pair", "int32 a\n", 3, msgdef="")
    with BagReader(tmp_path / "bag") as bag:
        (message,) = bag.messages()
        assert len(message.data) == 8
        with pytest.raises(BagError, match=r"no definition of my_msgs/msg/Pair.*Record as MCAP"):
            bag.deserialize(message)


def test_a_bad_definition_affects_only_its_own_topic(tmp_path):
    write_custom(tmp_path / "bag", "my_msgs/msg/Pair", "int32 a\n", 3, msgdef="int32 = = 3\n")
    with BagReader(tmp_path / "bag") as bag:
        (message,) = bag.messages()
        with pytest.raises(BagError, match="unusable definition of my_msgs/msg/Pair"):
            bag.deserialize(message)


def test_bytes_of_another_type_are_an_error(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/chatter", STRING, [])
        writer.write("/chatter", 7, b"\0\1\0\0\xff\xff\xff\x7f")
    with BagReader(tmp_path / "bag") as bag:
        (message,) = bag.messages()
        with pytest.raises(BagError, match=r"/chatter at 7 ns is not a std_msgs/msg/String"):
            bag.deserialize(message)
