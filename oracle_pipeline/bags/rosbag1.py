"""Read a ROS 1 bag, format 2.0: by its index, or without a usable one from the beginning."""

import itertools
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from typing import TypeAlias

from oracle_pipeline.bags import part
from oracle_pipeline.bags.compression import decompress
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_CHUNK, MOST_CHANNELS
from oracle_pipeline.bags.records import MOST_AT_ONCE, complete_size, ros1_records

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _BAG_HEADER, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_LARGEST_HEADER = 2**20  # bytes
_MOST_CHUNKS = 10_000_000

_Header: TypeAlias = dict[str, bytes]


class Rosbag1Part(part.FilePart):
    """A ROS 1 bag; a `Part`.

    Raises
    ------
    BagError
        If it is corrupt; a truncated file, or one without index, is read up to its end.
    """

    def _read_contents(self) -> None:
        self._is_cut = not self._read_index()
        if self._is_cut:
            self.channels = {}
            self._size = self._end = part.written_size(self._file)
            part.measure(self)

    def batches(self, wanted: Collection[int] | None = None) -> Iterator[part.Batch]:  # noqa: ARG002 -- the channels of a chunk are not known
        """Yield all messages, chunk by chunk."""
        at = len(MAGIC)
        self.cut, self.unread = "", 0
        while at < self._end:
            record = self._record(at)
            if record is None:
                padding = self._read(at, min(self._end - at, _LARGEST_HEADER))
                if self._is_cut or padding.strip(b"\0"):
                    self._stop(at, f"the record at byte {at} is incomplete")
                return
            header, begin, size = record
            is_whole = begin + size <= self._end
            opcode = _number(header, "op")
            if opcode == _CHUNK:
                data, reason = self._chunk(header, begin, size)
                yield from self._batches(data, at, is_whole=not reason)
                if reason:
                    self._stop(at, reason)
                    return
            elif opcode in (_CONNECTION, _MESSAGE) and is_whole:  # in no chunk
                yield from self._batches(self._read(at, begin + size - at), at, is_whole=True)
            if not is_whole:
                self._stop(at, f"the record at byte {at} is incomplete")
                return
            at = begin + size
        if self._is_cut:
            self.cut = "it has no index"

    def _batches(self, data: bytes, at: int, *, is_whole: bool) -> Iterator[part.Batch]:
        end = 0
        for records in ros1_records(data):
            for begin in records.described.tolist():
                if not self._describe(data, begin) and not self._is_cut:
                    raise self._corrupt(f"a connection in the chunk at byte {at} is not described")
            end = records.end
            yield from part.unpacked(data, records)
        if is_whole and end != len(data):
            raise self._corrupt(f"a record in the chunk at byte {at} ends beyond the chunk")

    def _chunk(self, header: _Header, begin: int, size: int) -> tuple[bytes, str]:
        """Return the records of a chunk; of a truncated one the complete ones, and the reason."""
        where = f"the chunk at byte {begin}"
        compression = header.get("compression", b"none").decode("utf-8", "replace")
        packed = self._read(begin, min(size, LARGEST_CHUNK))
        # What is not compressed is as large as it is, whatever it declares.
        declared = size if compression in ("", "none") else _number(header, "size")
        try:
            data = decompress(packed, compression, declared)
        except BagError as error:
            raise self._corrupt(f"at byte {begin}, {error}") from error
        except Exception as error:  # raised by any of the decompressors
            if self._is_cut:
                return b"", f"{where} cannot be decompressed: {error}"
            raise self._corrupt(f"{where} cannot be decompressed: {error}") from error
        if len(data) == declared:
            return data, ""
        if not self._is_cut:
            raise self._corrupt(f"{where} does not have the declared size of {declared} bytes")
        return data[: complete_size(ros1_records(data))], f"{where} is incomplete"

    def _corrupt(self, what: str) -> BagError:
        return BagError(f"{self.path} is corrupt: {what}. Copy it again, or see `rosbag fix`.")

    def _read(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        return self._file.read(max(0, min(size, self._size - at)))

    def _record(self, at: int) -> tuple[_Header, int, int] | None:
        """Return header, place and size of a record's data; None if the header is incomplete."""
        head = self._read(at, 4)
        length = int.from_bytes(head, "little")
        if len(head) < 4 or length > _LARGEST_HEADER:
            return None
        data = self._read(at + 4, length + 4)
        if len(data) < length + 4:
            return None
        header = _header(data[:length])
        if header is None or "op" not in header:
            return None
        return header, at + 8 + length, int.from_bytes(data[length:], "little")

    def _describe(self, data: bytes, at: int) -> bool:
        """Store the connection that a record describes; False if the record is invalid."""
        length = int.from_bytes(data[at : at + 4], "little")
        header = _header(data[at + 4 : at + 4 + length])
        at += 4 + length
        size = int.from_bytes(data[at : at + 4], "little")
        about = _header(data[at + 4 : at + 4 + size])
        if header is None or about is None:
            return False
        channel = part.Channel(
            header.get("topic", b"").decode("utf-8", "replace"),
            part.ros2_name(about.get("type", b"").decode("utf-8", "replace")), "ros1",
            about.get("message_definition", b"").decode("utf-8", "replace"), "msg", "", "",
        )  # fmt: skip
        part.add_channel(self.channels, _number(header, "conn"), channel)
        return True

    def _read_index(self) -> bool:
        """Read connections, counts and times from the index; False if there is none."""
        record = self._record(len(MAGIC))
        if record is None or _number(record[0], "op") != _BAG_HEADER:
            raise self._corrupt("it does not begin with the header of a bag")
        header = record[0]
        if header.get("encryptor"):
            raise BagError(f"{self.path} is encrypted; decrypt it first.")
        at = _number(header, "index_pos")
        connections, chunks = _number(header, "conn_count"), _number(header, "chunk_count")
        if not len(MAGIC) < at <= self._size or chunks > _MOST_CHUNKS:
            return False
        if connections > MOST_CHANNELS:
            raise BagError(
                f"{self.path} has {connections} connections; the limit is {MOST_CHANNELS} "
                "(MOST_CHANNELS)."
            )
        self._end = at
        spans: list[tuple[int, int, int]] = []
        counts = Counter[int]()
        largest = 0
        for _ in range(connections + chunks):
            record = self._record(at)
            if record is None or record[1] + record[2] > self._size:
                return False
            header, begin, size = record
            data = self._read(begin, size)
            if _number(header, "op") == _CONNECTION:
                if not self._describe(self._read(at, begin + size - at), 0):
                    return False
            elif _number(header, "op") == _CHUNK_INFO:
                held = Counter[int]()
                for connection, count in struct.iter_unpack("<II", data[: size // 8 * 8]):
                    held[connection] += count
                counts += held
                largest = max(largest, held.total())
                if data:
                    first, last = _time_ns(header, "start_time"), _time_ns(header, "end_time")
                    spans.append((_number(header, "chunk_pos"), first, last))
            at = begin + size
        self._set_extent(counts, spans)
        # A chunk that is read in several parts may have them in any order.
        self.extent.in_order &= largest <= MOST_AT_ONCE
        # The index ends the file. What follows may be zeros in place of a lost end.
        return at == self._size and counts.keys() <= self.channels.keys()

    def _set_extent(self, counts: Counter[int], spans: list[tuple[int, int, int]]) -> None:
        stamps = [(first, last) for _, first, last in sorted(spans)]
        if stamps:
            ends = itertools.pairwise(stamps)
            in_order = all(end <= begin for (_, end), (begin, _) in ends)
            firsts, lasts = zip(*stamps, strict=True)
            self.extent = part.Extent(+counts, min(firsts), max(lasts), in_order)


def _header(data: bytes) -> _Header | None:
    """Return the named fields of a header; None if it is broken."""
    fields: _Header = {}
    at = 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        name, equals, value = data[at + 4 : at + 4 + size].partition(b"=")
        if not equals or at + 4 + size > len(data):
            return None
        fields[name.decode("utf-8", "replace")] = value
        at += 4 + size
    return fields


def _number(header: _Header, name: str) -> int:
    return int.from_bytes(header.get(name, b""), "little")


def _time_ns(header: _Header, name: str) -> int:
    value = header.get(name, b"")
    return int.from_bytes(value[:4], "little") * 1_000_000_000 + int.from_bytes(value[4:], "little")
