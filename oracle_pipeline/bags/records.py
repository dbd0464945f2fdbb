"""One compiled pass over the records of a chunk: position, channel and time of each message.

A record of an MCAP file is an opcode, a length and that many bytes. A record of a ROS 1 bag is a
header (named fields) and data, each behind its length. Both functions stop where the bytes end or
are invalid, and return that position. A chunk may hold millions of small messages, so they are
returned in parts.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit

Bytes: TypeAlias = NDArray[np.uint8]

MCAP_SCHEMA, MCAP_CHANNEL, MCAP_MESSAGE = 0x03, 0x04, 0x05
_MCAP_HEAD, _MCAP_MESSAGE_HEAD = 9, 22
MOST_AT_ONCE = 2**18  # messages
SMALLEST_RECORD = _MCAP_HEAD + _MCAP_MESSAGE_HEAD  # bytes of a message
_ROS1_MESSAGE, _ROS1_CONNECTION = 0x02, 0x07


class Records(NamedTuple):
    """The records in a part of some bytes; the first four have a row for each message."""

    channels: NDArray[np.int64]  # as numbered in the file
    stamps_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]  # of the message's own bytes
    sizes: NDArray[np.int64]  # [B]
    described: NDArray[np.int64]  # where records begin that describe channels and types
    end: int  # of the last complete record of the part


def mcap_records(data: bytes, *, only_messages: bool = False) -> Iterator[Records]:
    """Index records of an MCAP file, at most `MOST_AT_ONCE` messages at a time.

    Parameters
    ----------
    data
        Complete records, one after the other; the last may be cut.
    only_messages
        Stop at a record that neither is a message nor describes one.
    """
    buffer = np.frombuffer(data, np.uint8)
    return _parts(lambda at: Records(*_index_mcap(buffer, at, MOST_AT_ONCE, only_messages)))


def ros1_records(data: bytes) -> Iterator[Records]:
    """Index records of a chunk of a ROS 1 bag, at most `MOST_AT_ONCE` messages at a time."""
    buffer = np.frombuffer(data, np.uint8)
    return _parts(lambda at: Records(*_index_ros1(buffer, at, MOST_AT_ONCE)))


def complete_size(parts: Iterator[Records]) -> int:
    """Return the number of bytes of complete records."""
    return max(records.end for records in parts)


def _parts(index: Callable[[int], Records]) -> Iterator[Records]:
    """Yield records part by part, each from the end of the previous one; at least once."""
    at, goes_on = 0, True
    while goes_on:
        records = index(at)
        at, goes_on = records.end, records.end > at
        if goes_on or at == 0:
            yield records


@jit
def _number(data: Bytes, at: int, size: int) -> Any:
    """Return a little-endian number; eight bytes that do not fit are negative."""
    number = np.int64(0)
    for i in range(size):
        number |= np.int64(data[at + i]) << np.int64(8 * i)
    return number


@jit
def _count_mcap(data: Bytes, at: int, most: int, only_messages: bool) -> Any:
    end, messages, described = len(data), 0, 0
    while at + _MCAP_HEAD <= end and messages < most:
        opcode = data[at]
        length = _number(data, at + 1, 8)
        if opcode == 0 or length < 0 or length > end - at - _MCAP_HEAD:
            break
        if opcode == MCAP_MESSAGE:
            if length < _MCAP_MESSAGE_HEAD:
                break
            messages += 1
        elif opcode in (MCAP_SCHEMA, MCAP_CHANNEL):
            described += 1
        elif only_messages:
            break
        at += _MCAP_HEAD + length
    return messages, described, at


@jit
def _index_mcap(data: Bytes, at: int, most: int, only_messages: bool) -> Any:
    messages, others, end = _count_mcap(data, at, most, only_messages)
    channels, stamps = np.empty(messages, np.int64), np.empty(messages, np.int64)
    offsets, sizes = np.empty(messages, np.int64), np.empty(messages, np.int64)
    described = np.empty(others, np.int64)
    message, other = 0, 0
    while at < end:
        opcode, length = data[at], _number(data, at + 1, 8)
        begin = at + _MCAP_HEAD
        if opcode == MCAP_MESSAGE:
            channels[message] = _number(data, begin, 2)
            stamps[message] = _number(data, begin + 6, 8)
            offsets[message] = begin + _MCAP_MESSAGE_HEAD
            sizes[message] = length - _MCAP_MESSAGE_HEAD
            message += 1
        elif opcode in (MCAP_SCHEMA, MCAP_CHANNEL):
            described[other] = at
            other += 1
        at = begin + length
    return channels, stamps, offsets, sizes, described, end


@jit
def _ros1_head(data: Bytes, at: int, end: int) -> Any:
    """Return opcode, connection, stamp [ns] and length of a header; opcode -1 if it is broken."""
    opcode, connection, stamp = np.int64(-1), np.int64(-1), np.int64(-1)
    while at + 4 <= end:
        size = _number(data, at, 4)
        at += 4
        if size > end - at:
            return np.int64(-1), connection, stamp
        # The names that are needed differ in their first letter and length.
        if size == 4 and data[at] == 111 and data[at + 1] == 112:  # op=
            opcode = np.int64(data[at + 3])
        elif size == 9 and data[at] == 99 and data[at + 4] == 61:  # conn=
            connection = _number(data, at + 5, 4)
        elif size == 13 and data[at] == 116 and data[at + 4] == 61:  # time=
            stamp = _number(data, at + 5, 4) * 1_000_000_000 + _number(data, at + 9, 4)
        at += size
    return opcode, connection, stamp


@jit
def _index_ros1(data: Bytes, at: int, most: int) -> Any:
    end = len(data)
    most = min(most, end // 40 + 1)  # a message takes more: lengths, op, conn and time
    channels, stamps = np.empty(most, np.int64), np.empty(most, np.int64)
    offsets, sizes = np.empty(most, np.int64), np.empty(most, np.int64)
    described = np.empty(most, np.int64)
    messages, others = 0, 0
    while at + 8 <= end and messages < most and others < most:
        head = _number(data, at, 4)
        if head > end - at - 8:
            break
        opcode, connection, stamp = _ros1_head(data, at + 4, at + 4 + head)
        body = at + 4 + head
        size = _number(data, body, 4)
        if opcode < 0 or size > end - body - 4:
            break
        if opcode == _ROS1_MESSAGE:
            if connection < 0 or stamp < 0:
                break
            channels[messages], stamps[messages] = connection, stamp
            offsets[messages], sizes[messages] = body + 4, size
            messages += 1
        elif opcode == _ROS1_CONNECTION:
            described[others] = at
            others += 1
        at = body + 4 + size
    return (
        channels[:messages].copy(), stamps[:messages].copy(), offsets[:messages].copy(),
        sizes[:messages].copy(), described[:others].copy(), at,
    )  # fmt: skip
