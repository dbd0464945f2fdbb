"""Messages that differ from each other in a few numbers only, laid out as rows of bytes.

A sensor sends the same frame, covariances and field names two hundred times a second. Here a
message is serialised once and numpy writes the numbers over it, for many messages at a time.
"""

import functools
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import serialize, typestore

STAMP = ("header.stamp.sec", "header.stamp.nanosec")
"""The fields of a header's stamp, which differs in every message."""

_NUMPY_NAMES = {"byte": "int8", "char": "uint8", "octet": "uint8"}  # others are numpy's own
_ARRAY = 64  # from this many numbers on, numpy writes a row faster than struct
_HEADER = 4  # bytes of CDR's encapsulation; alignment counts from their end


class Template:
    """CDR bytes of messages like ``prototype``.

    Parameters
    ----------
    prototype
        A message; strings and lengths are the same in all.
    msgtype
        Its type.
    fields
        The fields that differ: a number (``header.stamp.sec``), or an array or a message of numbers
        of one type (``orientation``, ``pose.pose``), which is then a row of numbers.

    Raises
    ------
    BagError
        If a field does not exist, or holds anything but numbers of one type.
    """

    def __init__(self, prototype: Any, msgtype: str, fields: Sequence[str]) -> None:
        leaves = list(_leaves(msgtype, prototype))
        numbers = {field: _numbers(leaves, field, msgtype) for field in fields}
        data = serialize(prototype, msgtype)
        self._dtype = np.dtype(
            {
                "names": list(numbers),
                "formats": [kind for kind, _ in numbers.values()],
                "offsets": [_HEADER + offset for _, offset in numbers.values()],
                "itemsize": len(data),
            }
        )
        self._row = np.frombuffer(data, np.uint8)
        self._buffer = bytearray(data)
        self._count = len(fields)
        self._fill = [*self._fillers(list(numbers.values()))]

    def _fillers(
        self, numbers: Sequence[tuple[tuple[str, tuple[int, ...]], int]]
    ) -> Iterator[Callable[[Sequence[Any]], None]]:
        """Yield functions that write adjacent numbers, or a row, into the buffer."""
        number = 0
        while number < len(numbers):
            (kind, shape), offset = numbers[number]
            begin, formats, end = number, "<", offset
            number += 1
            if shape:
                yield _row_filler(self._buffer, np.dtype(kind), shape, _HEADER + offset, begin)
                continue
            for (other, other_shape), beside in numbers[begin:]:
                if other_shape or beside != end:
                    break
                formats += np.dtype(other).char
                end = beside + np.dtype(other).itemsize
            number = begin + len(formats) - 1
            pack = functools.partial(
                struct.Struct(formats).pack_into, self._buffer, _HEADER + offset
            )
            yield _numbers_filler(pack, begin, number)

    def data(self, *values: Any) -> bytes:
        """Return one message, from one value or row of numbers for each field."""
        if len(values) != self._count:
            raise ValueError(f"expected {self._count} values, found {len(values)}")
        for fill in self._fill:
            fill(values)
        return bytes(self._buffer)

    def rows(self, count: int) -> NDArray[np.void]:
        """Return ``count`` copies, as a structured array with one column per field, to write to."""
        return np.tile(self._row, count).view(self._dtype)


def _numbers_filler(
    pack: Callable[..., None], begin: int, end: int
) -> Callable[[Sequence[Any]], None]:
    if begin == 0 and end == 2:  # a stamp, as a rule
        return lambda values: pack(values[0], values[1])
    return lambda values: pack(*values[begin:end])


def _row_filler(
    buffer: bytearray, kind: np.dtype[Any], shape: tuple[int, ...], offset: int, index: int
) -> Callable[[Sequence[Any]], None]:
    count = math.prod(shape)
    if count > _ARRAY:
        row = np.frombuffer(buffer, kind, count, offset)
        return lambda values: row.__setitem__(slice(None), np.ravel(values[index]))
    pack = struct.Struct(f"<{count}{kind.char}").pack_into
    return lambda values: pack(buffer, offset, *values[index])


class _Leaf(NamedTuple):
    """Numbers of one type, or a string, that lie next to each other in a message."""

    path: str
    kind: str  # numpy's name of the type, or "string"
    offset: int
    shape: tuple[int, ...]  # empty for a single value


def _numbers(
    leaves: Sequence[_Leaf], field: str, msgtype: str
) -> tuple[tuple[str, tuple[int, ...]], int]:
    """Return numpy format and offset of a field."""
    inside = [leaf for leaf in leaves if f"{leaf.path}.".startswith(f"{field}.")]
    kinds = {leaf.kind for leaf in inside}
    if len(kinds) != 1 or "string" in kinds:
        raise BagError(f"{field!r} of {msgtype} is not made of numbers of one type.")
    shape = inside[0].shape
    if inside[0].path != field:
        shape = (sum(math.prod(leaf.shape) for leaf in inside),)
    return (kinds.pop(), shape), inside[0].offset


def _leaves(msgtype: str, message: Any) -> Iterator[_Leaf]:
    """Yield everything in a message in the order of CDR."""
    position = 0

    def walk(path: str, desc: Any, value: Any) -> Iterator[_Leaf]:
        nonlocal position
        kind, detail = desc
        if kind == Nodetype.NAME:
            for name, part in typestore().fielddefs[detail][1]:
                yield from walk(f"{path}.{name}", part, getattr(value, name))
        elif kind == Nodetype.BASE and detail[0] == "string":
            position = _aligned(position, 4)
            yield _Leaf(path[1:], "string", position, ())
            position += 4 + len(value.encode()) + 1
        elif kind == Nodetype.BASE:
            yield from numbers(path, detail[0], ())
        else:
            (element, length) = detail
            if kind == Nodetype.SEQUENCE:
                position = _aligned(position, 4) + 4
                length = len(value)
            if element[0] == Nodetype.BASE and element[1][0] != "string":
                yield from numbers(path, element[1][0], (length,))
            else:
                for index in range(length):
                    yield from walk(f"{path}.{index}", element, value[index])

    def numbers(path: str, name: str, shape: tuple[int, ...]) -> Iterator[_Leaf]:
        nonlocal position
        dtype = np.dtype(_NUMPY_NAMES.get(name, name)).newbyteorder("<")
        count = math.prod(shape)
        if count:  # an empty array is not aligned
            position = _aligned(position, dtype.itemsize)
            yield _Leaf(path[1:], dtype.str, position, shape)
        position += dtype.itemsize * count

    yield from walk("", (Nodetype.NAME, msgtype), message)


def _aligned(position: int, size: int) -> int:
    return -size * (-position // size)
