"""What the messages of a topic have, by its type, and their header stamps.

Stamps are read from the bytes, without decoding the rest: this runs for every message of every bag.
Only sequences of floating-point numbers count as arrays: integers are mostly codes (cells of a
grid, pixels, identifiers).
"""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.reader import BagReader

_HEADER = "std_msgs/msg/Header"
_LITTLE_ENDIAN = 1  # bit of the second byte
_SHORTEST_WITH_HEADER = 12  # bytes of a message that has a stamp

_FLOATS = tuple((Nodetype.BASE, (name, 0)) for name in ("float32", "float64"))
_BIG_STAMP, _LITTLE_STAMP = struct.Struct(">iI"), struct.Struct("<iI")


class MessageLayout:
    """Whether the messages of one topic have a header and an array, and their header stamps.

    A type without a known definition has neither.
    """

    def __init__(self, bag: BagReader, topic: str) -> None:
        self.is_cdr = bag.topics[topic].encoding != "ros1"
        self.has_header = self.has_array = False
        msgtype = bag.topics[topic].msgtype
        try:
            store = bag.typestore(msgtype)
            self.has_header = has_header(store, msgtype)
            self.has_array = _has_array(store, msgtype)
        except (BagError, KeyError):
            return

    def header_stamp_ns(self, data: bytes) -> int | None:
        """Return the stamp in the header of a message [ns]; None if it has no header."""
        if not self.has_header or len(data) < _SHORTEST_WITH_HEADER:
            return None
        stamp = _BIG_STAMP if self.is_cdr and not data[1] & _LITTLE_ENDIAN else _LITTLE_STAMP
        # After the encapsulation, or ROS 1's sequence number.
        sec, nanosec = stamp.unpack_from(data, 4)
        return int(sec) * 1_000_000_000 + int(nanosec)


def has_header(store: Typestore, msgtype: str) -> bool:
    """Return whether the first field of a type is a header."""
    fields = store.fielddefs[msgtype][1]
    return bool(fields) and fields[0][1] == (Nodetype.NAME, _HEADER)


def _has_array(store: Typestore, msgtype: Any) -> bool:
    """Return whether a type has what `Columns.first_array` returns."""
    return any(
        what[0] in _FLOATS if kind == Nodetype.SEQUENCE
        else kind == Nodetype.NAME and _has_array(store, what)
        for _, (kind, what) in store.fielddefs[msgtype][1]
    )  # fmt: skip


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
