"""Faster writing gives the same bytes as rosbags, which is not changed."""

import subprocess
import sys

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from oracle_pipeline.bags.storage import Writer
from oracle_pipeline.bags.types import definition, type_hash
from tests.oracle_pipeline.bags.conftest import CLOCK, STRING

UNPATCHED = """
import rosbags.rosbag1, rosbags.rosbag2, sys
from rosbags.rosbag2 import metadata, reader, storage_mcap, storage_sqlite3, writer
modules = [m for name, m in sys.modules.items() if name.startswith("rosbags")]
def state():
    held = [(m.__name__, key, id(value)) for m in modules for key, value in vars(m).items()]
    classes = {v for m in modules for v in vars(m).values() if isinstance(v, type)}
    return held, [(c.__name__, key, id(v)) for c in sorted(classes, key=str)
                  for key, v in vars(c).items() if key != "__abstractmethods__"]
before = state()
import oracle_pipeline.bags.reader, oracle_pipeline.bags.writer
assert state() == before
"""


@pytest.mark.parametrize("storage", StoragePlugin)
def test_a_bag_is_the_one_that_rosbags_writes(storage, qos, tmp_path):
    folders = []
    for name, make in (("ours", Writer), ("theirs", RosbagsWriter)):
        writer = make(tmp_path / name / "bag", version=8, storage_plugin=storage)
        if storage is StoragePlugin.MCAP:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            channels = [
                _channel(writer, *each)
                for each in (
                    ("/a", CLOCK, [qos(1)]),
                    ("/b", CLOCK, []),
                    ("/c", STRING, [qos(2)] * 2),
                )
            ]
            for i in range(2000):  # more than a chunk
                writer.write(channels[i % 2], 10**9 - i, bytes(i % 1500))
        folders.append({f.name: f.read_bytes() for f in (tmp_path / name / "bag").iterdir()})
    ours, theirs = folders
    assert ours["metadata.yaml"] == theirs["metadata.yaml"]
    if storage is StoragePlugin.MCAP:  # SQLite counts transactions
        assert without_checksums(ours["bag.mcap"]) == theirs["bag.mcap"]


def test_importing_reader_and_writer_does_not_change_rosbags():
    subprocess.run([sys.executable, "-c", UNPATCHED], check=True)


def without_checksums(content):
    """Return the bytes of an MCAP file with zeros where its checksums are: rosbags writes none."""
    content, at = bytearray(content), 8
    while at < len(content) - 8:
        end = at + 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        checksums = {0x06: at + 9 + 24, 0x0F: end - 4, 0x02: end - 4}  # chunk, data end, footer
        if (checksum := checksums.get(content[at])) is not None:
            content[checksum : checksum + 4] = bytes(4)
        at = end
    return bytes(content)


def _channel(writer, topic, msgtype, profiles):
    text, digest = definition(msgtype), type_hash(msgtype)
    if isinstance(writer, Writer):
        return writer.add_topic(topic, msgtype, text, digest, profiles)
    return writer.add_connection(
        topic, msgtype, msgdef=text, rihs01=digest, offered_qos_profiles=profiles
    )
