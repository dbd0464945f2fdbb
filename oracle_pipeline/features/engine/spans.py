"""Spans of a recording, and the part of ascending times that is in one."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit

Integers: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Span:
    """A half-open interval of a recording, in nanoseconds since its start."""

    start_ns: int
    end_ns: int

    @property
    def start_s(self) -> float:
        """Start [s]."""
        return self.start_ns / 1e9

    @property
    def end_s(self) -> float:
        """End [s]."""
        return self.end_ns / 1e9

    def slice_of(self, times_ns: Integers) -> slice:
        """Return the slice of ascending times that is in the span."""
        return slice(*between(times_ns, self.start_ns, self.end_ns))


@jit
def between(times: NDArray[Any], start: float, end: float) -> tuple[int, int]:
    """Return the first index at or after the start, and the first at or after the end.

    As ``np.searchsorted``, which takes longer for a window's few numbers.
    """
    first = _from(times, start)
    return first, _from(times, end)


@jit
def _from(times: NDArray[Any], start: float) -> int:
    low, high = 0, len(times)
    while low < high:
        middle = (low + high) // 2
        if times[middle] < start:
            low = middle + 1
        else:
            high = middle
    return low
