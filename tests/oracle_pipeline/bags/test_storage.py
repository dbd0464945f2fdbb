"""What the storages do faster than rosbags, they do as rosbags does it."""

import tempfile
from operator import itemgetter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, ReaderError, StoragePlugin
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import Writer as RosbagsWriter

from oracle_pipeline.bags.storage import Reader, Writer, _messages
from oracle_pipeline.bags.types import definition, type_hash

CLOCK = "rosgraph_msgs/msg/Clock"
CHUNK = 2**20  # bytes; a message that fills it ends it


def all_messages(make, path, topics=None):
    with make(path) as bag:
        wanted = [c for c in bag.connections if topics is None or c.topic in topics]
        return [(c.topic, stamp_ns, data) for c, stamp_ns, data in bag.messages(wanted)]


def test_every_bag_at_hand_reads_as_with_rosbags(any_bag):
    messages = all_messages(Reader, any_bag)
    assert messages == all_messages(RosbagsReader, any_bag)
    topics = {topic for topic, _, _ in messages[:3]}
    assert all_messages(Reader, any_bag, topics) == all_messages(RosbagsReader, any_bag, topics)


@settings(max_examples=40, deadline=None)
@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from(["/clock", "/late"]),
            st.integers(0, 9),  # few stamps: equal ones, within a chunk and across
            st.sampled_from([0, 1, 40, CHUNK]),
        ),
        min_size=1,
        max_size=12,
    ),
    is_sorted=st.booleans(),
    mode=st.sampled_from(CompressionMode),
)
def test_chunks_in_any_order_of_time_read_as_with_rosbags(messages, is_sorted, mode):
    """Where chunks overlap in time they are merged, and where not they are read in turn."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            channels = {topic: _channel(writer, topic) for topic in ("/clock", "/late")}
            for topic, stamp_ns, size in (
                sorted(messages, key=itemgetter(1)) if is_sorted else messages
            ):
                writer.write(channels[topic], stamp_ns, bytes([stamp_ns]) * size)
        for topics in (None, {"/late"}):
            expected = all_messages(RosbagsReader, path, topics)
            assert all_messages(Reader, path, topics) == expected
        assert len(all_messages(Reader, path)) == len(messages)


def test_a_record_that_ends_beyond_its_chunk_is_no_message():
    record = b"\x05" + (30).to_bytes(8, "little") + bytes(30)
    assert list(_messages(record, {})) == []
    with pytest.raises(ReaderError, match="beyond its chunk"):
        list(_messages(record[:-1], {}))


def test_a_record_packed_in_one_go_is_the_one_that_rosbags_writes(tmp_path):
    files = []
    for name, make in (("ours_0", Writer), ("theirs_0", RosbagsWriter)):
        writer = make(tmp_path / name / "bag", version=8, storage_plugin=StoragePlugin.MCAP)
        with writer:
            channels = [_channel(writer, topic) for topic in ("/clock", "/late")]
            for i in range(2000):  # more than a chunk
                writer.write(channels[i % 2], 10**9 - i, bytes(i % 1500))
        files.append(without_checksums(tmp_path / name / "bag" / "bag.mcap"))
    assert files[0] == files[1]


def without_checksums(path):
    """Return the bytes of an MCAP file with zeros where its checksums are: rosbags writes none."""
    content, at = bytearray(path.read_bytes()), 8
    while at < len(content) - 8:
        end = at + 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        checksums = {0x06: at + 9 + 24, 0x0F: end - 4, 0x02: end - 4}  # chunk, data end, footer
        if (checksum := checksums.get(content[at])) is not None:
            content[checksum : checksum + 4] = bytes(4)
        at = end
    return bytes(content)


def _channel(writer, topic):
    return writer.add_connection(topic, CLOCK, msgdef=definition(CLOCK), rihs01=type_hash(CLOCK))
