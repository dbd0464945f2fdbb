"""Header stamp and array of a message, read from its bytes without decoding the rest.

This runs for every topic of every bag, so it must be cheap: an array is one ``numpy.frombuffer``
after a few skipped fields. Only sequences of floating-point numbers are used: integers are mostly
codes (cells of a grid, pixels, identifiers).
"""

import struct
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.cdr import DTYPES, ENCAPSULATION, aligned
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.reader import BagReader

_HEADER = "std_msgs/msg/Header"
_ENCAPSULATION = len(ENCAPSULATION)
_LITTLE_ENDIAN = 1  # bit of the second byte
_SHORTEST_WITH_HEADER = 12  # bytes of a message that has a stamp

_FLOATS = tuple((Nodetype.BASE, (name, 0)) for name in ("float32", "float64"))
_BIG_STAMP, _LITTLE_STAMP = struct.Struct(">iI"), struct.Struct("<iI")
_COUNTS = {">": struct.Struct(">I"), "<": struct.Struct("<I")}  # by byte order


class _Numbers(NamedTuple):
    """Consecutive numbers of one size."""

    size: int
    times: int


class _Text(NamedTuple):
    """A string."""


class _Repeated(NamedTuple):
    """A repeated group of fields."""

    fields: "tuple[_Field, ...]"
    times: int | None  # None: given in the message


_Field: TypeAlias = _Numbers | _Text | _Repeated


class MessageLayout:
    """Locations of the header stamp and of the first array in the messages of one topic.

    A type without a known definition has neither.
    """

    def __init__(self, bag: BagReader, topic: str) -> None:
        self.is_cdr = bag.topics[topic].encoding != "ros1"
        self.has_header = False
        self._before: list[_Field] = []
        self._elements: dict[str, np.dtype[Any]] = {}  # of the array, by byte order
        msgtype = bag.topics[topic].msgtype
        try:
            store = bag.typestore(msgtype)
            fields = store.fielddefs[msgtype][1]
            self.has_header = bool(fields) and fields[0][1] == (Nodetype.NAME, _HEADER)
            if (element := self._seek(store, msgtype)) is not None:
                self._elements = {order: element.newbyteorder(order) for order in (">", "<")}
        except (BagError, KeyError):
            return

    @property
    def has_array(self) -> bool:
        """Whether the type has a sequence of floating-point numbers."""
        return bool(self._elements)

    def header_stamp_ns(self, data: bytes) -> int | None:
        """Return the stamp in the header of a message [ns]; None if it has no header."""
        if not self.has_header or len(data) < _SHORTEST_WITH_HEADER:
            return None
        stamp = _BIG_STAMP if self.is_cdr and not data[1] & _LITTLE_ENDIAN else _LITTLE_STAMP
        # After the encapsulation, or ROS 1's sequence number.
        sec, nanosec = stamp.unpack_from(data, 4)
        return int(sec) * 1_000_000_000 + int(nanosec)

    def array(self, data: bytes) -> NDArray[np.floating[Any]] | None:
        """Return the array of a message; None if its type has none or its bytes are broken."""
        if not self._elements:
            return None
        try:
            order = self._order(data)
            cursor = _Cursor(data, order, is_cdr=self.is_cdr)
            cursor.skip(self._before)
            count = cursor.count()
            element = self._elements[order]
            if count:
                cursor.align(element.itemsize)
            return np.frombuffer(data, element, count, cursor.position)
        except (struct.error, ValueError, IndexError):
            return None

    def _order(self, data: bytes) -> Literal["<", ">"]:
        return "<" if not self.is_cdr or data[1] & _LITTLE_ENDIAN else ">"

    def _seek(self, store: Typestore, msgtype: Any) -> np.dtype[Any] | None:
        """Record the fields before the first array of a type; return the type of its elements."""
        if msgtype == _HEADER and not self.is_cdr:
            self._before.append(_Numbers(4, 1))
        for _, (kind, what) in store.fielddefs[msgtype][1]:
            if kind == Nodetype.SEQUENCE and what[0] in _FLOATS:
                return np.dtype(what[0][1][0])
            if kind == Nodetype.NAME:
                if (element := self._seek(store, what)) is not None:
                    return element
            else:
                self._skip_too(self._field(store, kind, what))
        return None

    def _skip_too(self, field: _Field) -> None:
        """Append a field to those before the array; numbers of one size become one."""
        last = self._before[-1] if self._before else None
        if isinstance(last, _Numbers) and isinstance(field, _Numbers) and last.size == field.size:
            self._before[-1] = _Numbers(field.size, last.times + field.times)
        else:
            self._before.append(field)

    def _field(self, store: Typestore, kind: Nodetype, what: Any) -> _Field:
        """Return the layout of a field, for skipping it."""
        if kind == Nodetype.BASE:
            return _Text() if what[0] == "string" else _Numbers(DTYPES[what[0]].itemsize, 1)
        if kind == Nodetype.NAME:
            fields = [self._field(store, *each) for _, each in store.fielddefs[what][1]]
            number = [_Numbers(4, 1)] if what == _HEADER and not self.is_cdr else []
            return _Repeated((*number, *fields), 1)
        element, count = what
        repeated = self._field(store, *element)
        if kind == Nodetype.ARRAY and isinstance(repeated, _Numbers):
            return _Numbers(repeated.size, count)
        return _Repeated((repeated,), count if kind == Nodetype.ARRAY else None)


class HeaderStamps:
    """Reads the stamps in the headers of messages, many at once.

    Parameters
    ----------
    layouts : sequence of MessageLayout
        By number of the topic.
    """

    NONE = int(np.iinfo(np.int64).min)  # of a message without a header

    def __init__(self, layouts: Sequence[MessageLayout]) -> None:
        self._with_header = {  # which topics have one, by encoding
            is_cdr: np.array(
                [each.has_header and each.is_cdr == is_cdr for each in layouts], dtype=np.bool_
            )
            for is_cdr in (False, True)
        }

    def of_batch(self, batch: Messages) -> NDArray[np.int64]:
        """Return the stamp of each message of a batch [ns]."""
        stamps_ns = np.full(len(batch.topics), self.NONE)
        data = np.frombuffer(batch.data, np.uint8)
        for is_cdr, with_header in self._with_header.items():
            rows = np.flatnonzero(
                with_header[batch.topics] & (batch.sizes >= _SHORTEST_WITH_HEADER)
            )
            if len(rows):
                stamps_ns[rows] = _stamps_ns(data, batch.offsets[rows], is_cdr)
        return stamps_ns


@jit
def _stamps_ns(
    data: NDArray[np.uint8], offsets: NDArray[np.int64], is_cdr: bool
) -> NDArray[np.int64]:
    stamps_ns = np.empty(len(offsets), np.int64)
    for i in range(len(offsets)):
        begin = offsets[i] + 4  # after the encapsulation, or ROS 1's sequence number
        is_big = is_cdr and not data[offsets[i] + 1] & _LITTLE_ENDIAN
        seconds = nanoseconds = np.int64(0)
        for j in range(4):
            shift = np.int64(8 * (3 - j if is_big else j))
            seconds |= np.int64(data[begin + j]) << shift
            nanoseconds |= np.int64(data[begin + 4 + j]) << shift
        seconds -= (seconds >> 31) << 32  # a signed number of 32 bits
        stamps_ns[i] = seconds * 1_000_000_000 + nanoseconds
    return stamps_ns


class _Cursor:
    """A position in the bytes of a message."""

    def __init__(self, data: bytes, order: str, *, is_cdr: bool) -> None:
        self.position = _ENCAPSULATION if is_cdr else 0
        self._data = data
        self._count = _COUNTS[order].unpack_from
        self.is_cdr = is_cdr

    def align(self, size: int) -> None:
        if self.is_cdr:
            self.position = _ENCAPSULATION + aligned(self.position - _ENCAPSULATION, size)

    def count(self) -> int:
        """Read the length of a sequence or a string."""
        self.align(4)
        (count,) = self._count(self._data, self.position)
        self.position += 4
        if count > len(self._data):
            raise ValueError(f"a length of {count} in a message of {len(self._data)} bytes")
        return int(count)

    def skip(self, fields: "tuple[_Field, ...] | list[_Field]") -> None:
        """Skip fields."""
        for field in fields:
            if isinstance(field, _Text):
                length = self.count()
                self.position += length
            elif isinstance(field, _Numbers):
                self.align(field.size)
                self.position += field.size * field.times
            else:
                for _ in range(self.count() if field.times is None else field.times):
                    self.skip(field.fields)
