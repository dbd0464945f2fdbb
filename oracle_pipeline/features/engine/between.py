"""The part of ascending times that is in a span."""

from typing import Any

from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit


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
