"""Statistics of arrays of numbers, for many arrays at a time.

``generic`` reduces them to windows and topics; ``topic_pairs`` compares topics by them.
"""

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit, jit_unchecked
from oracle_pipeline.features.engine.plugin import Request, Series, Window
from oracle_pipeline.features.statistics.reduction import row_medians

Floats: TypeAlias = NDArray[np.float64]

STATISTICS = ("non_finite", "at_limit", "distinct", "autocorrelation", "roughness")

_EVERY_S = 0.1  # between the sampled arrays
_BLOCK = 2**16  # numbers per batch
_SHORTEST, _LONGEST = 16, 2048  # numbers; shorter arrays are channels, not samples of one quantity


def _arrays_of(messages: Any) -> list[NDArray[np.floating[Any]] | None]:
    """Return the array of each message, or the middle of a long one; None if it is too short.

    They are copies of the same precision as the messages, to save memory.
    """
    return [_middle(array) if array.size >= _SHORTEST else None for array in messages.first_array]


def _middle(array: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    first = max(0, (array.size - _LONGEST) // 2)
    return array[first : first + _LONGEST].copy()


#: Request of plugins that look into arrays: ten messages per second of each topic with arrays.
ARRAYS = Request(
    _arrays_of, dtype=object, optional=True, many=True, every_s=_EVERY_S, needs_array=True
)


def each(function: Callable[..., Any], *arrays: NDArray[np.object_]) -> list[Any]:
    """Call a function of arrays, shape (n, m), on batches of arrays of equal length.

    Parameters
    ----------
    function : callable
        Returns a result for each row of its arguments.
    *arrays : ndarray of arrays
        The arguments, with equally many arrays; arrays at the same index are equally long.
    """
    lengths = np.array([array.size for array in arrays[0]])
    results: list[Any] = [None] * len(lengths)
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        for block in np.array_split(rows, math.ceil(len(rows) * length / _BLOCK) or 1):
            stacked = (
                np.concatenate(some[block].tolist()).reshape(len(block), length) for some in arrays
            )
            for row, result in zip(block.tolist(), function(*stacked), strict=True):
                results[row] = result
    return results


def statistics(arrays: NDArray[np.floating[Any]]) -> Floats:
    """Return the ``STATISTICS`` of each row, shape (n, 5), NaN where too few numbers are finite.

    They are the share of inf and NaN; of the finite numbers the share that equals the largest or
    the smallest, the share of distinct ones and the correlation with their next; the roughness.
    """
    numbers = _numbers(arrays)
    totals = np.nansum(numbers, axis=1)
    return np.column_stack([_shares(numbers, np.sort(numbers, axis=1), totals), roughness(arrays)])


def statistics_of_topics(window: Window) -> dict[str, Series]:
    """Return the `STATISTICS` of each array that a plugin requested as ``arrays``, by topic.

    They are computed once for all plugins of a recording.
    """
    if statistics not in window.shared:
        window.shared[statistics] = {
            topic: Series(times_s, np.array(each(statistics, arrays)))
            for topic, (times_s, arrays) in window.topics["arrays"].items()
        }
    by_topic: dict[str, Series] = window.shared[statistics]
    return by_topic


def roughness(arrays: NDArray[np.floating[Any]]) -> Floats:
    """Return the median of abs(a[i-1] - 2 a[i] + a[i+1]) / abs(a[i]) of each row, shape (n,).

    Zeros and neighbours of non-finite numbers are left out; NaN if all numbers are.
    """
    return row_medians(_bends(_numbers(arrays)))


@jit
def autocorrelation(numbers: Floats, mean: float) -> float:
    """Return the correlation of numbers with their next ones; NaN is left out, or if all are."""
    product = power = 0.0
    for j in range(len(numbers) - 1):
        current, following = numbers[j] - mean, numbers[j + 1] - mean
        if not math.isnan(current * following):
            product += current * following
            power += current * current + following * following
    return product / (power / 2.0) if power > 0.0 else math.nan


def doubled_ranks(arrays: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    """Return twice the ranks in each row, from 2 on, with averaged ties; NaN ranks as ``inf``.

    It is ``scipy.stats.rankdata``, whose import takes longer than most recordings.
    """
    numbers = np.where(np.isnan(arrays), np.inf, arrays)
    order = np.argsort(numbers, axis=1)
    return _shared(np.take_along_axis(numbers, order, axis=1), order)


def standardised(doubled: NDArray[np.uint16]) -> Floats:
    """Return the ranks in each row, centred and scaled to unit length.

    The dot product of two is Spearman's correlation; a constant row is all zero.
    """
    ranks = doubled / 2.0
    ranks -= ranks.mean(axis=1, keepdims=True)
    length = np.linalg.norm(ranks, axis=1, keepdims=True)
    np.divide(ranks, length, out=ranks, where=length > 0.0)
    return ranks


@jit
def _shared(ordered: NDArray[np.floating[Any]], order: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Return twice the rank of each number, given the numbers of each row in order."""
    doubled = np.empty(order.shape, np.uint16)
    for i in range(len(order)):
        first = 0
        for last in range(order.shape[1]):
            if last + 1 < order.shape[1] and ordered[i, last + 1] == ordered[i, first]:
                continue
            for place in range(first, last + 1):
                doubled[i, order[i, place]] = first + last + 2
            first = last + 1
    return doubled


def _numbers(arrays: NDArray[np.floating[Any]]) -> Floats:
    """Return arrays as float64, NaN for infinity."""
    return np.where(np.isfinite(arrays), arrays, np.nan).astype(np.float64, copy=False)


@jit_unchecked
def _bends(numbers: Floats) -> Floats:
    """Return abs(a[i-1] - 2 a[i] + a[i+1]) / abs(a[i]) of each row, NaN at zeros."""
    bends = np.empty((len(numbers), max(0, numbers.shape[1] - 2)))
    for i in range(len(bends)):
        for j in range(bends.shape[1]):
            size = abs(numbers[i, j + 1])
            bend = abs(numbers[i, j] - 2.0 * numbers[i, j + 1] + numbers[i, j + 2])
            bends[i, j] = bend / size if size > 0.0 else math.nan
    return bends


@jit
def _shares(numbers: Floats, ordered: Floats, totals: Floats) -> Floats:
    """Return the first four of the ``STATISTICS`` of each row, given its order and its sum."""
    found = np.full((len(numbers), 4), np.nan)
    for i in range(len(numbers)):
        count = numbers.shape[1]
        while count and math.isnan(ordered[i, count - 1]):
            count -= 1
        found[i, 0] = 1.0 - count / numbers.shape[1]
        if count:
            least, largest = ordered[i, 0], ordered[i, count - 1]
            at_limit = distinct = 0
            for j in range(count):
                at_limit += ordered[i, j] == least or ordered[i, j] == largest
                distinct += j == 0 or ordered[i, j] > ordered[i, j - 1]
            found[i, 1], found[i, 2] = at_limit / count, distinct / count
            found[i, 3] = autocorrelation(numbers[i], totals[i] / count)
    return found
