"""Read any MCAP file: chunked or not, with or without a summary, complete or truncated.

The specification is at mcap.dev. A summary is used to open a file fast. Messages are always read
from the data section, record by record, so a missing or incomplete index loses none.
"""

import itertools
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from typing import NamedTuple

from oracle_pipeline.bags import part
from oracle_pipeline.bags.compression import decompress
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_CHUNK
from oracle_pipeline.bags.mcap_checksums import check_summary
from oracle_pipeline.bags.records import (
    MCAP_CHANNEL,
    MCAP_MESSAGE,
    MCAP_SCHEMA,
    MOST_AT_ONCE,
    SMALLEST_RECORD,
    complete_size,
    mcap_records,
)

MAGIC = b"\x89MCAP0\r\n"

_FOOTER, _CHUNK, _CHUNK_INDEX, _STATISTICS, _DATA_END = 0x02, 0x06, 0x08, 0x0B, 0x0F
_LAST_STANDARD, _FIRST_PRIVATE = 0x0F, 0x80  # opcodes
_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_CHUNK_HEAD = struct.Struct("<QQQII")  # first, last stamp; size, checksum; length of a name
_BLOCK = 8 * 2**20  # bytes read at once of messages that are in no chunk
_FORMATS = {"ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl", "ros1msg": "msg"}


class _Schema(NamedTuple):
    name: str
    format: str
    text: str


class _Stretch(NamedTuple):
    """Decompressed records, and their position in the file."""

    data: bytes
    at: int
    is_chunk: bool


class Fields:
    """Reads the fields of a record one after the other."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self._data, self.at = data, at

    def number(self, size: int) -> int:
        """Return an unsigned number of some bytes."""
        field = self._data[self.at : self.at + size]
        if len(field) < size:
            raise ValueError("a record is shorter than its fields")
        self.at += size
        return int.from_bytes(field, "little")

    def block(self, width: int = 4) -> bytes:
        """Return bytes behind their length, which has a width in bytes."""
        size = self.number(width)
        field = self._data[self.at : self.at + size]
        if len(field) < size:
            raise ValueError("a field is longer than its record")
        self.at += size
        return field

    def text(self) -> str:
        """Return a string behind its length."""
        return self.block().decode("utf-8", "replace")


class McapPart(part.FilePart):
    """An MCAP file; a `Part`.

    Raises
    ------
    BagError
        If it is corrupt; a truncated file is read up to its end.
    """

    def _read_contents(self) -> None:
        self._schemas: dict[int, _Schema] = {}
        self._chunk_channels: dict[int, frozenset[int]] = {}  # by where the chunk begins
        summary = self._summary_start()
        self._is_cut = summary is None
        if self._is_cut:
            self._end = part.written_size(self._file)
        else:
            self._check_summary()
        if not (summary and self._read_summary(summary)):
            self.channels, self._schemas, self._chunk_channels = {}, {}, {}
            part.measure(self)

    def batches(self, wanted: Collection[int] | None = None) -> Iterator[part.Batch]:
        """Yield all messages; chunks without any of the wanted channels are skipped."""
        for data, at, is_chunk in self._stretches(wanted):
            end = 0
            for records in mcap_records(data, only_messages=not is_chunk):
                for begin in records.described.tolist():
                    opcode, length = _HEAD.unpack_from(data, begin)
                    begin += _HEAD.size
                    self._describe(opcode, data[begin : begin + length])
                end = records.end
                yield from part.unpacked(data, records)
            if end != len(data) and not self._is_cut:
                raise self._corrupt(f"a record in the chunk at byte {at} ends beyond the chunk")

    # Records of the data section.

    def _stretches(self, wanted: Collection[int] | None) -> Iterator[_Stretch]:
        at = len(MAGIC)
        self.cut, self.unread = "", 0
        while True:
            head = self._read(at, _HEAD.size)
            if len(head) < _HEAD.size:
                self._stop(at, "the file ends where a record should begin")
                return
            opcode, length = _HEAD.unpack(head)
            if opcode in (_DATA_END, _FOOTER):
                self.cut = "it has no footer" if self._is_cut else ""
                return
            if opcode == 0 or _LAST_STANDARD < opcode < _FIRST_PRIVATE:
                self._stop(at, f"there is no record at byte {at}")
                return
            if opcode in (MCAP_SCHEMA, MCAP_CHANNEL, MCAP_MESSAGE):
                data = self._messages(at, length)
                if not data:
                    self._stop(at, f"the record at byte {at} is incomplete")
                    return
                yield _Stretch(data, at, is_chunk=False)
                at += len(data)
                continue
            end = at + _HEAD.size + length
            if opcode == _CHUNK and self._may_hold(at, wanted):
                data, reason = self._chunk(at, length)
                if data:
                    yield _Stretch(data, at, is_chunk=True)
                if reason:
                    self._stop(at, reason)
                    return
            if end > self._end:
                self._stop(at, f"the record at byte {at} is incomplete")
                return
            at = end

    def _may_hold(self, chunk: int, wanted: Collection[int] | None) -> bool:
        known = self._chunk_channels.get(chunk)
        return wanted is None or not known or not known.isdisjoint(wanted)

    def _messages(self, at: int, length: int) -> bytes:
        """Return complete records outside of chunks, from a position on."""
        size = max(_BLOCK, _HEAD.size + min(length, self._end))
        if length > LARGEST_CHUNK and at + length <= self._end:
            raise self._corrupt(
                f"the record at byte {at} has {length} bytes; the limit is {LARGEST_CHUNK} "
                "(LARGEST_CHUNK)"
            )
        data = self._read(at, min(size, LARGEST_CHUNK))
        return data[: complete_size(mcap_records(data, only_messages=True))]

    def _chunk(self, at: int, length: int) -> tuple[bytes, str]:
        """Return the records of a chunk; of a truncated one the complete ones, and the reason."""
        begin = at + _HEAD.size
        head = self._read(begin, _CHUNK_HEAD.size)
        if len(head) < _CHUNK_HEAD.size:
            return b"", f"the chunk at byte {at} is incomplete"
        *_, size, checksum, name_size = _CHUNK_HEAD.unpack(head)
        begin += _CHUNK_HEAD.size
        name = self._read(begin, min(name_size, 64)).decode("utf-8", "replace")
        begin += name_size
        packed_size = int.from_bytes(self._read(begin, 8), "little")
        begin += 8
        if begin > self._end:
            return b"", f"the chunk at byte {at} is incomplete"
        if begin + packed_size > at + _HEAD.size + length:
            return self._broken(at, "is longer than its record")
        packed = self._read(begin, min(packed_size, LARGEST_CHUNK))
        try:
            data = decompress(packed, name, size)
        except BagError as error:
            raise self._corrupt(f"at byte {at}, {error}") from error
        except Exception as error:  # raised by any of three decompressors
            return self._broken(at, f"cannot be decompressed: {error}")
        if len(packed) < packed_size and self._is_cut:
            size = complete_size(mcap_records(data))
            return data[:size], f"the chunk at byte {at} is incomplete"
        if len(data) != size:
            return self._broken(at, f"does not have the declared size of {size} bytes")
        if checksum and zlib.crc32(data) != checksum:
            return self._broken(at, "differs from its checksum (CRC-32)")
        return data, ""

    def _broken(self, at: int, what: str) -> tuple[bytes, str]:
        """Report a broken chunk: as the end of a truncated file, or as an error."""
        if self._is_cut:
            return b"", f"the chunk at byte {at} {what}"
        raise self._corrupt(f"the chunk at byte {at} {what}")

    def _corrupt(self, what: str) -> BagError:
        return BagError(
            f"{self.path} is corrupt: {what}. Copy it again, or see what `mcap recover` saves."
        )

    def _read(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        return self._file.read(max(0, min(size, self._end - at)))

    # Schemas, channels and the summary.

    def _describe(self, opcode: int, data: bytes) -> None:
        fields = Fields(data)
        try:
            number = fields.number(2)
            if opcode == MCAP_SCHEMA:
                name, encoding, text = fields.text(), fields.text(), fields.text()
                self._schemas.setdefault(number, _Schema(name, _FORMATS.get(encoding, ""), text))
            elif number not in self.channels:
                schema = self._schemas.get(fields.number(2), _Schema("", "", ""))
                topic, encoding = fields.text(), fields.text()
                more = _metadata(Fields(fields.block()))
                channel = part.Channel(
                    topic, part.ros2_name(schema.name), encoding, schema.text, schema.format,
                    more.get("topic_type_hash", ""), more.get("offered_qos_profiles", ""),
                )  # fmt: skip
                part.add_channel(self.channels, number, channel)
        except ValueError as error:
            raise self._corrupt(str(error)) from error

    def _summary_start(self) -> int | None:
        """Return where the summary begins, 0 without one; None if the file is truncated."""
        size = _HEAD.size + 20 + len(MAGIC)
        tail = self._read(max(0, self._size - size), size)
        if self._size < len(MAGIC) + size or not tail.endswith(MAGIC):
            return None
        opcode, length = _HEAD.unpack_from(tail)
        if (opcode, length) != (_FOOTER, 20):
            return None
        start = int.from_bytes(tail[_HEAD.size : _HEAD.size + 8], "little")
        return start if start < self._size - size else 0

    def _check_summary(self) -> None:
        try:
            check_summary(self._file)
        except BagError as error:
            raise self._corrupt(str(error)) from error

    def _read_summary(self, start: int) -> bool:
        """Read channels, counts and times from the summary; False if it lacks them."""
        data = self._read(start, min(self._size - start, LARGEST_CHUNK))
        statistics: Fields | None = None
        spans: list[tuple[int, int, int]] = []
        at = largest = 0
        try:
            while at + _HEAD.size <= len(data) and data[at] != _FOOTER:
                opcode, length = _HEAD.unpack_from(data, at)
                record = data[at + _HEAD.size : at + _HEAD.size + length]
                if opcode in (MCAP_SCHEMA, MCAP_CHANNEL):
                    self._describe(opcode, record)
                elif opcode == _CHUNK_INDEX:
                    span, size = self._chunk_index(Fields(record))
                    spans.append(span)
                    largest = max(largest, size)
                elif opcode == _STATISTICS:
                    statistics = Fields(record)
                at += _HEAD.size + length
            if statistics is None:
                return False
            self.extent = _extent(statistics, spans)
            # A chunk that is read in several parts may have them in any order.
            self.extent.in_order &= largest <= MOST_AT_ONCE * SMALLEST_RECORD
        except (ValueError, struct.error, BagError):
            return False
        return self.extent.counts.keys() <= self.channels.keys()

    def _chunk_index(self, fields: Fields) -> tuple[tuple[int, int, int], int]:
        """Store the channels of a chunk; return its position, first and last stamp, and size.

        The size is that of the decompressed content.
        """
        first, last, chunk = fields.number(8), fields.number(8), fields.number(8)
        fields.number(8)
        offsets = fields.block()
        channels = frozenset(number for number, _ in struct.iter_unpack("<HQ", offsets))
        self._chunk_channels[chunk] = channels
        fields.number(8)
        fields.block()
        fields.number(8)
        return (chunk, first, last), fields.number(8)


def _extent(fields: Fields, spans: list[tuple[int, int, int]]) -> part.Extent:
    messages = fields.number(8)
    fields.number(2)
    for _ in range(4):
        chunks = fields.number(4)  # the last of them: schemas, channels and attachments come first
    start_ns, end_ns = fields.number(8), fields.number(8)
    counts = Counter(dict(struct.iter_unpack("<HQ", fields.block())))
    if counts.total() != messages or chunks != len(spans):
        raise ValueError("the summary contradicts itself")
    ordered = sorted(spans)
    in_order = chunks > 0 and all(
        end <= begin for (_, _, end), (_, begin, _) in itertools.pairwise(ordered)
    )
    if end_ns >= 2**63:  # nanoseconds: the year 2262
        raise ValueError("some stamps are beyond any recording")
    return part.Extent(+counts, start_ns, end_ns, in_order) if messages else part.Extent()


def _metadata(fields: Fields) -> dict[str, str]:
    found: dict[str, str] = {}
    while True:
        try:
            key = fields.text()
        except ValueError:
            return found
        found[key] = fields.text()
