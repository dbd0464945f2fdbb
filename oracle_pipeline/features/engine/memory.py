"""The memory that plugins may use for what they keep, and estimates of what an object takes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.limits import MOST_KEPT

_MESSAGE_BYTES = 40
_OBJECT_BYTES = 64  # of a small Python object, and of an array without its numbers
_SAMPLE = 16  # rows of a batch whose sizes are measured
# As tuples, since a union would be made anew for each message.
_CONTAINERS = np.ndarray, tuple, list
_MEASURED = np.ndarray, tuple, float, type(None)  # kept objects of known size


class MemoryBudget:
    """The memory that the rows of all topics together may take."""

    def __init__(self) -> None:
        self._left = MOST_KEPT

    def count(self, messages: int) -> None:
        """Subtract what is kept of every message: its time, size and stamp."""
        self._left -= messages * _MESSAGE_BYTES

    def take(self, size: int) -> bool:
        """Subtract a size; return False if the budget is exceeded."""
        self._left -= size
        return self._left >= 0


def size_of_row(row: Any, message_size: int) -> int:
    """Return the approximate size of a row [B]; objects of unknown size may hold their message."""
    return max(_size(row), 0 if isinstance(row, _MEASURED) else message_size)


def _size(kept: Any) -> int:
    """Return the approximate size of an object in memory [B]."""
    if isinstance(kept, np.ndarray) and kept.dtype != object:
        return int(kept.nbytes) + _OBJECT_BYTES
    if isinstance(kept, _CONTAINERS):
        return _OBJECT_BYTES + sum(map(_size, kept))
    return _OBJECT_BYTES


def size_of_array(rows: NDArray[Any]) -> int:
    """Return the size of rows that are an array [B]; their concatenation needs a copy."""
    return 2 * rows.nbytes


def size_of_rows(kept: Any, messages: Sequence[bytes]) -> int:
    """Return the approximate size of rows [B], given as columns or one by one.

    Objects of unknown size may hold their messages.
    """
    if isinstance(kept, tuple):
        return sum(_size_of_column(column) for column in kept)
    step = 1 + len(kept) // _SAMPLE
    some = kept[::step]
    held = 0 if all(isinstance(each, _MEASURED) for each in some) else sum(map(len, messages))
    return max(held, step * sum(map(_size, some)))


def _size_of_column(column: Any) -> int:
    if isinstance(column, np.ndarray) and column.dtype != object:
        return len(column) * _OBJECT_BYTES
    distinct = {id(each): each for each in column}  # names of frames are shared
    return len(column) * _OBJECT_BYTES + sum(map(_size, distinct.values()))
