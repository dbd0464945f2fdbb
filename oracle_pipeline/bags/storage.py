"""rosbags' reader and writer of rosbag2, with the loops over messages of an MCAP file made short.

A run has a hundred thousand small messages, and it is read for its features, its picture and its
check: what is done once a message decides what writing and reading a bag cost. What is done once
a file, a topic or a chunk is left to rosbags.
"""

import struct
from collections.abc import Collection, Generator, Iterator
from operator import itemgetter

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, ReaderError, StoragePlugin
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, McapWriter, decompress

from oracle_pipeline.bags import mcap_checksums

# The head of a message: opcode, length of the rest; channel, sequence, log and publish time.
_MESSAGE, _HEAD = 0x05, struct.Struct("<BQHIQQ")
_LENGTH_FIRST = struct.Struct("<BQ")  # of any record: opcode, length of the rest
_FIELDS_SIZE = _HEAD.size - _LENGTH_FIRST.size
_CHUNK_HEAD = struct.Struct("<BQQQQI")  # opcode, length; first and last stamp, size, checksum


class _McapWriter(McapWriter):
    """A message's record is packed in one go, and every checksum is written."""

    _CHUNK_SIZE = 2**20

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message to the open chunk."""
        chunk, channel = self.chunk, connection.id
        self.message_start_time = min(timestamp, self.message_start_time)
        self.message_end_time = max(timestamp, self.message_end_time)
        chunk.message_start_time = min(timestamp, chunk.message_start_time)
        chunk.message_end_time = max(timestamp, chunk.message_end_time)
        self.channel_stats[channel] += 1
        chunk.msgs[channel].append((timestamp, chunk.bio.tell()))
        size = _FIELDS_SIZE + len(data)
        chunk.bio.write(_HEAD.pack(_MESSAGE, size, channel, 0, timestamp, timestamp))
        chunk.bio.write(data)
        if chunk.bio.tell() > self._CHUNK_SIZE:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write the open chunk with its checksum."""
        start, records = self.bio.tell(), self.chunk.bio
        super().close_chunk()
        mcap_checksums.write_of_chunk(self.bio, start, records.getbuffer())

    def close(self, version: int, metadata: str) -> None:
        """Write what is behind the chunks, and the checksums of the two sections."""
        super().close(version, metadata)
        mcap_checksums.write_of_sections(self.path)


class Writer(RosbagsWriter):
    """It does not look each message's connection up among all: it is one that was added here."""

    STORAGE_PLUGINS = {**RosbagsWriter.STORAGE_PLUGINS, StoragePlugin.MCAP: _McapWriter}  # noqa: RUF012

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message."""
        if self.storage is None or self.compression_mode is CompressionMode.MESSAGE:
            super().write(connection, timestamp, data)  # says that it is not open, or compresses
            return
        self.storage.write(connection, timestamp, data)
        self.counts[connection.id] += 1
        self.min_timestamp = min(timestamp, self.min_timestamp)
        self.max_timestamp = max(timestamp, self.max_timestamp)


class _McapReader(McapReader):
    """Chunks that follow one another in time, as a recorder writes them, are read in turn."""

    def _open(self) -> None:
        """Compare the summary with its checksum before anything of it is used."""
        if self.bio is not None:
            mcap_checksums.check_summary(self.bio)
        super()._open()

    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield the messages of some connections in time order."""
        if start is not None or stop is not None or not self._is_in_order():
            yield from super().messages(connections, start, stop)
            return
        wanted = {connection.id: connection for connection in connections}
        for chunk in self.chunks:
            if not wanted.keys().isdisjoint(chunk.channel_count):
                found = list(_messages(self._records(chunk), wanted))
                yield from sorted(found, key=itemgetter(1))

    def _is_in_order(self) -> bool:
        """Tell whether there are chunks, and each begins where the one before it has ended."""
        ends = [chunk.message_end_time for chunk in self.chunks]
        begins = [chunk.message_start_time for chunk in self.chunks[1:]]
        return bool(ends) and all(end <= begin for end, begin in zip(ends, begins, strict=False))

    def _records(self, chunk: ChunkInfo) -> bytes:
        """Return the records of a chunk."""
        if self.bio is None:
            raise ReaderError("the bag is not open")
        self.bio.seek(chunk.chunk_start_offset)
        *_, checksum = _CHUNK_HEAD.unpack(self.bio.read(_CHUNK_HEAD.size))
        # Then name of the compression and length of what is compressed, each with its own length.
        self.bio.seek(4 + len(chunk.compression) + 8, 1)
        packed = self.bio.read(chunk.compressed_size)
        return decompress(packed, chunk.compression, chunk.uncompressed_size, checksum)


def _messages(
    records: bytes, wanted: dict[int, Connection]
) -> Iterator[tuple[Connection, int, bytes]]:
    at, end = 0, len(records)
    unpack, get = _HEAD.unpack_from, wanted.get
    while at < end:
        if records[at] == _MESSAGE:
            _, size, channel, _, stamp, _ = unpack(records, at)
            begin, at = at + _HEAD.size, at + _LENGTH_FIRST.size + size
            if (connection := get(channel)) is not None:
                yield connection, stamp, records[begin:at]
        else:
            at += _LENGTH_FIRST.size + _LENGTH_FIRST.unpack_from(records, at)[1]
    if at != end:
        raise ReaderError(f"a record ends {at - end} bytes beyond its chunk")


class _DirectoryReader(DirectoryReader):
    STORAGE_PLUGINS = {**DirectoryReader.STORAGE_PLUGINS, "mcap": _McapReader}  # noqa: RUF012


class Reader(RosbagsReader):
    """Reads what rosbags reads."""

    STORAGE_PLUGINS = {  # noqa: RUF012
        **RosbagsReader.STORAGE_PLUGINS,
        "dir": _DirectoryReader,
        ".mcap": _McapReader,
    }
