"""Finishes an MCAP file in place whose writer was killed or had no space left.

It is cut after its last whole chunk, and gets the summary that its writer could not write. So other
tools open it, and nothing is copied: the disk may be full.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from io import BufferedWriter, BytesIO
from pathlib import Path
from typing import NamedTuple, cast
from zlib import crc32

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2.storage_mcap import Channel, PendingChunk, Schema

from oracle_pipeline.bags import storage
from oracle_pipeline.bags.batch_storage import BatchMcapWriter
from oracle_pipeline.bags.compression import decompress
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.mcap import MAGIC, Fields
from oracle_pipeline.bags.records import MCAP_CHANNEL, MCAP_SCHEMA, mcap_records

_HEADER, _CHUNK, _INDEX = 0x01, 0x06, 0x07
_HEAD = struct.Struct("<BQ")


class NoMessageError(BagError):
    """The file has no whole chunk."""


def finish_mcap(path: Path) -> storage.Information:
    """Finish a file that `BatchMcapWriter` began; return what ``metadata.yaml`` tells of it.

    Raises
    ------
    NoMessageError
        If it has no whole chunk.
    OSError
        If there is no space for the summary; the file is then readable as before.
    """
    writer = _Resumed(path)
    topics = [
        (_connection(channel, writer.schemas), profiles, writer.channel_stats[channel.id])
        for channel, profiles in writer.described()
    ]
    file = storage.BagFile(path.name, writer.message_start_time, writer.message_end_time)
    told = storage.information("mcap", file, topics)
    writer.close(storage.METADATA_VERSION, storage.as_yaml(told).strip())
    return told


class _Group(NamedTuple):
    """A chunk and the indexes behind it; positions are in the file."""

    start: int
    end: int  # of the chunk
    indexes: dict[int, int]  # where the index of each channel begins
    behind: int  # end of the last index


class _Resumed(BatchMcapWriter):
    """A writer in the state in which it had written the whole chunks of a file."""

    def __init__(self, path: Path) -> None:
        self.path, self.bio = path, cast("BufferedWriter", path.open("r+b"))
        self.schemas, self.channels, self.chunks = [], [], []
        self.compression = "zstd"
        self.channel_stats = {}
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), {})
        self.message_start_time, self.message_end_time = 2**63 - 1, 0
        self._index = []
        end = 0
        for group in self._groups():
            self._take(group)
            end = group.behind
        if not end:
            self.bio.close()
            raise NoMessageError(
                f"{path} holds no message: its recorder ended in its first second."
            )
        self.bio.seek(end)
        self.bio.truncate()

    def described(self) -> Iterator[tuple[Channel, str]]:
        """Yield each channel with its QoS profiles as text."""
        for channel in self.channels:
            fields = Fields(channel.metadata)
            fields.text()  # the key, "offered_qos_profiles"
            yield channel, fields.text()

    def _groups(self) -> Iterator[_Group]:
        """Yield the whole chunks, until the file ends or is broken."""
        size = self.path.stat().st_size
        at, group = len(MAGIC), None
        while True:
            self.bio.seek(at)
            head = self.bio.read(_HEAD.size)
            if len(head) < _HEAD.size:
                break
            opcode, length = _HEAD.unpack(head)
            end = at + _HEAD.size + length
            if end > size or opcode not in (_HEADER, _CHUNK, _INDEX):
                break
            if opcode == _INDEX and group is not None:
                group.indexes[int.from_bytes(self.bio.read(2), "little")] = at
                group = group._replace(behind=end)
            elif opcode == _CHUNK:
                if group is not None:
                    yield group
                group = _Group(at, end, {}, end)
            at = end
        if group is not None:
            yield group

    def _take(self, group: _Group) -> None:
        """Read what a chunk holds, as if it had just been written."""
        self.bio.seek(group.start + _HEAD.size)
        fields = Fields(self.bio.read(group.end - group.start - _HEAD.size))
        first, last = fields.number(8), fields.number(8)
        size, checksum = fields.number(8), fields.number(4)
        name, packed = fields.text(), fields.block(8)
        data = decompress(packed, name, size)
        if crc32(data) != checksum:
            raise BagError(f"{self.path}: the chunk at byte {group.start} is damaged.")
        for records in mcap_records(data):
            for begin in records.described.tolist():
                self._describe(data, begin)
            for channel, count in Counter(records.channels.tolist()).items():
                self.channel_stats[channel] += count
        self.message_start_time = min(self.message_start_time, first)
        self.message_end_time = max(self.message_end_time, last)
        index = b"".join(struct.pack("<HQ", *entry) for entry in group.indexes.items())
        span = struct.pack("<QQQQI", first, last, group.start, group.end - group.start, len(index))
        sizes = struct.pack("<QQ", len(packed), size)
        text = struct.pack("<I", len(name)) + name.encode()
        record = BytesIO()
        record.write(span + index + struct.pack("<Q", group.behind - group.end) + text + sizes)
        self.chunks.append(record)

    def _describe(self, data: bytes, begin: int) -> None:
        opcode, length = _HEAD.unpack_from(data, begin)
        fields = Fields(data[begin + _HEAD.size : begin + _HEAD.size + length])
        number = fields.number(2)
        if opcode == MCAP_SCHEMA:
            name, encoding, text = fields.text(), fields.text(), fields.text()
            self.schemas.append(Schema(number, name, encoding, text))
        elif opcode == MCAP_CHANNEL:
            schema = fields.number(2)
            (msgtype,) = (each.name for each in self.schemas if each.id == schema)
            topic, encoding, metadata = fields.text(), fields.text(), fields.block()
            self.channels.append(Channel(number, msgtype, topic, encoding, metadata))
            self.channel_stats[number] = 0


def _connection(channel: Channel, schemas: list[Schema]) -> Connection:
    (schema,) = (each for each in schemas if each.name == channel.schema)
    form = MessageDefinitionFormat.MSG
    return Connection(
        channel.id, channel.topic, schema.name, MessageDefinition(form, schema.data),
        "", 0, ConnectionExtRosbag2("cdr", []), None,
    )  # fmt: skip
