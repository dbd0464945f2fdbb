"""The layout of CDR, in which ROS 2 encodes messages: sizes, alignment, and where fields lie.

A number is aligned to its size, a string is a length, its bytes and a zero, a sequence a length and
its elements. Everything here is little-endian, as the encapsulation in front of a message says;
alignment counts from its end. ROS 1's encoding is the same without encapsulation and alignment.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from oracle_pipeline.bags.types import typestore

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The bytes before a little-endian message."""

_NAMES = {"bool": "?", "byte": "i1", "char": "u1", "octet": "u1"}
_NAMES |= {
    f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)
}
DTYPES: Mapping[str, np.dtype[Any]] = {
    name: np.dtype(f"<{code}")
    for name, code in (_NAMES | {"float32": "f4", "float64": "f8"}).items()
}
"""The type of each kind of number, by ROS's name."""

_COUNT = DTYPES["uint32"].itemsize  # of a length


class Leaf(NamedTuple):
    """Numbers of one type, or a string, that lie next to each other in a message."""

    path: str  # pose.position.x
    dtype: np.dtype[Any] | None  # None for a string
    offset: int  # after the encapsulation [B]
    shape: tuple[int, ...]  # empty for a single value


def aligned(position: int, size: int) -> int:
    """Return the next position from here on where something of this size may lie."""
    return position + -position % size


def is_number(desc: Any) -> bool:
    """Return whether a field, by its description in a type store, is a single number."""
    kind, detail = desc
    return bool(kind == Nodetype.BASE and detail[0] in DTYPES)


def leaves(msgtype: str, message: Any) -> Iterator[Leaf]:
    """Yield everything in a message of our type store, in its order, but empty arrays."""
    position = 0

    def walk(path: str, desc: Any, value: Any) -> Iterator[Leaf]:
        nonlocal position
        kind, detail = desc
        if kind == Nodetype.NAME:
            for name, part in typestore().fielddefs[detail][1]:
                yield from walk(f"{path}.{name}", part, getattr(value, name))
        elif is_number(desc):
            yield from numbers(path, detail[0], ())
        elif kind == Nodetype.BASE:
            position = aligned(position, _COUNT)
            yield Leaf(path[1:], None, position, ())
            position += _COUNT + len(value.encode()) + 1
        else:
            element, length = detail
            if kind == Nodetype.SEQUENCE:
                position = aligned(position, _COUNT) + _COUNT
                length = len(value)
            if is_number(element):
                yield from numbers(path, element[1][0], (length,))
            else:
                for index in range(length):
                    yield from walk(f"{path}.{index}", element, value[index])

    def numbers(path: str, name: str, shape: tuple[int, ...]) -> Iterator[Leaf]:
        nonlocal position
        dtype, count = DTYPES[name], math.prod(shape)
        if count:  # an empty array is not aligned
            position = aligned(position, dtype.itemsize)
            yield Leaf(path[1:], dtype, position, shape)
        position += dtype.itemsize * count

    yield from walk("", (Nodetype.NAME, msgtype), message)
