"""Messages that differ from each other in a few numbers only, laid out as rows of bytes.

A sensor sends the same frame, covariances and field names two hundred times a second. Here a
message is serialised once and numpy writes the numbers over it, for many messages at a time.
"""

import functools
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.cdr import ENCAPSULATION, Leaf, leaves
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import serialize

STAMP = ("header.stamp.sec", "header.stamp.nanosec")
"""The fields of a header's stamp, which differs in every message."""

_ARRAY = 64  # from this many numbers on, numpy writes a row faster than struct
_BEGIN = len(ENCAPSULATION)


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
        layout = list(leaves(msgtype, prototype))
        numbers = {field: _numbers(layout, field, msgtype) for field in fields}
        data = serialize(prototype, msgtype)
        self._dtype = np.dtype(
            {
                "names": list(numbers),
                "formats": [kind for kind, _ in numbers.values()],
                "offsets": [_BEGIN + offset for _, offset in numbers.values()],
                "itemsize": len(data),
            }
        )
        self._row = np.frombuffer(data, np.uint8)
        self._buffer = bytearray(data)
        self._count = len(fields)
        self._fill = [*self._fillers(list(numbers.values()))]

    def _fillers(
        self, numbers: Sequence[tuple[tuple[np.dtype[Any], tuple[int, ...]], int]]
    ) -> Iterator[Callable[[Sequence[Any]], None]]:
        """Yield functions that write adjacent numbers, or a row, into the buffer."""
        number = 0
        while number < len(numbers):
            (dtype, shape), offset = numbers[number]
            begin, formats, end = number, "<", offset
            number += 1
            if shape:
                yield _row_filler(self._buffer, dtype, shape, _BEGIN + offset, begin)
                continue
            for (other, other_shape), beside in numbers[begin:]:
                if other_shape or beside != end:
                    break
                formats += other.char
                end = beside + other.itemsize
            number = begin + len(formats) - 1
            pack = functools.partial(
                struct.Struct(formats).pack_into, self._buffer, _BEGIN + offset
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


def _numbers(
    layout: Sequence[Leaf], field: str, msgtype: str
) -> tuple[tuple[np.dtype[Any], tuple[int, ...]], int]:
    """Return numpy format and offset of a field."""
    inside = [leaf for leaf in layout if f"{leaf.path}.".startswith(f"{field}.")]
    dtypes = {leaf.dtype for leaf in inside}
    dtype = dtypes.pop() if len(dtypes) == 1 else None
    if dtype is None:
        raise BagError(f"{field!r} of {msgtype} is not made of numbers of one type.")
    shape = inside[0].shape
    if inside[0].path != field:
        shape = (sum(math.prod(leaf.shape) for leaf in inside),)
    return (dtype, shape), inside[0].offset
