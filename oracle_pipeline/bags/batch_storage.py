"""rosbags' storages of rosbag2, written in batches of messages.

Work for each message dominates the cost of recording. So messages are packed in batches, and the
index of an MCAP chunk is computed when the chunk ends.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from oracle_pipeline.bags import mcap_checksums

# The head of a message: opcode, length of the rest; channel, sequence, log and publish time.
_MESSAGE, _HEAD = 0x05, struct.Struct("<BQHIQQ")
_HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
     ("log", "<u8"), ("publish", "<u8")]
)  # fmt: skip
_LENGTH_FIRST = struct.Struct("<BQ")  # of any record: opcode, length of the rest
_FIELDS_SIZE = _HEAD.size - _LENGTH_FIRST.size
# Opcode, length; first and last stamp, size, checksum.
_CHUNK, _CHUNK_HEAD = 0x06, struct.Struct("<BQQQQI")
_INDEX, _INDEX_HEAD = 0x07, struct.Struct("<BQHI")  # opcode, length; channel, size of its entries

_Integers = NDArray[np.integer]


class BatchMcapWriter(McapWriter):
    """Messages are packed in batches, and the index of a chunk is made when it ends."""

    _CHUNK_SIZE = 2**20

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._index: list[tuple[_Integers, _Integers, _Integers]] = []  # of the open chunk

    def write_many(
        self, channels: Sequence[int], stamps: Sequence[int], payloads: Sequence[bytes]
    ) -> None:
        """Append messages; a chunk ends after the message that makes it too large."""
        count = len(payloads)
        sizes = np.fromiter(map(len, payloads), np.int64, count)
        heads = np.zeros(count, _HEADS)
        heads["opcode"], heads["length"] = _MESSAGE, _FIELDS_SIZE + sizes
        heads["channel"], heads["log"], heads["publish"] = channels, stamps, stamps
        parts = interleaved(heads.tobytes(), payloads)
        ends = np.cumsum(_HEAD.size + sizes)
        for channel, number in Counter(channels).items():
            self.channel_stats[channel] += number
        begin = 0
        while begin < count:
            # Where message 0 of the batch would begin in the open chunk.
            origin = self.chunk.bio.tell() - (int(ends[begin - 1]) if begin else 0)
            end = int(np.searchsorted(ends, self._CHUNK_SIZE - origin, side="right")) + 1
            some = slice(begin, min(end, count))
            self.chunk.bio.writelines(parts[2 * some.start : 2 * some.stop])
            self._note(heads["channel"][some], heads["log"][some],
                       origin + ends[some] - _HEAD.size - sizes[some])  # fmt: skip
            if end <= count:
                self.close_chunk()
            begin = end

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message."""
        self.write_many([connection.id], [timestamp], [bytes(data)])

    def _note(self, channels: _Integers, stamps: _Integers, offsets: _Integers) -> None:
        """Record the positions of messages in the open chunk."""
        first, last = int(stamps.min()), int(stamps.max())
        for times in (self, self.chunk):
            times.message_start_time = min(first, times.message_start_time)
            times.message_end_time = max(last, times.message_end_time)
        self._index.append((channels, stamps, offsets))

    def close_chunk(self) -> None:
        """Write the open chunk with its checksum, followed by the index of its messages."""
        chunk = self.chunk
        records: Any = chunk.bio.getbuffer()  # compressors take any buffer
        packed, size = self.compressor(records), len(records)
        start = self.bio.tell()
        name = struct.pack("<I", len(self.compression)) + self.compression.encode()
        span = (chunk.message_start_time, chunk.message_end_time)
        self.bio.write(
            _CHUNK_HEAD.pack(
                _CHUNK, _CHUNK_HEAD.size - _LENGTH_FIRST.size + len(name) + 8 + len(packed),
                *span, size, zlib.crc32(records),
            )
        )  # fmt: skip
        self.bio.write(name + struct.pack("<Q", len(packed)))
        self.bio.write(packed)
        end = self.bio.tell()
        index, at = b"", end
        for channel, entries in self._entries():
            index += struct.pack("<HQ", channel, at)
            head = _INDEX_HEAD.pack(_INDEX, 6 + len(entries), channel, len(entries))
            at += self.bio.write(head + entries)
        summary = struct.pack("<QQQQI", *span, start, end - start, len(index)) + index
        summary += struct.pack("<Q", at - end) + name
        summary += struct.pack("<QQ", len(packed), size)
        record = BytesIO()
        record.write(summary)  # rosbags reads its length with tell()
        self.chunks.append(record)
        self._index.clear()
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), {})

    def close(self, version: int, metadata: str) -> None:
        """Write the records after the chunks, and the checksums of the two sections."""
        super().close(version, metadata)
        mcap_checksums.write_of_sections(self.path)

    def _entries(self) -> Iterator[tuple[int, bytes]]:
        """Yield stamps and offsets of each channel's messages, channels by their first message."""
        if not self._index:
            return
        channels, stamps, offsets = map(np.concatenate, zip(*self._index, strict=True))
        order = np.argsort(channels, kind="stable")
        entries = np.column_stack([stamps, offsets])[order].astype("<u8", copy=False)
        names, begins = np.unique(channels[order], return_index=True)
        ends = np.append(begins[1:], len(order))
        for number in np.argsort(order[begins]).tolist():
            yield int(names[number]), entries[begins[number] : ends[number]].tobytes()


class BatchSqlite3Writer(Sqlite3Writer):
    """Messages are inserted in batches."""

    def write_many(
        self, channels: Sequence[int], stamps: Sequence[int], payloads: Sequence[bytes]
    ) -> None:
        """Append messages."""
        self.cursor.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)",
            zip(channels, stamps, payloads, strict=True),
        )

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message."""
        self.write_many([connection.id], [timestamp], [bytes(data)])


def interleaved(heads: bytes, payloads: Sequence[bytes]) -> list[bytes]:
    """Return heads and payloads alternately; all heads have the same size."""
    size = len(heads) // max(len(payloads), 1)
    parts = [b""] * (2 * len(payloads))
    parts[0::2] = [heads[at : at + size] for at in range(0, len(heads), size)]
    parts[1::2] = payloads
    return parts
