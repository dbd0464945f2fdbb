"""Statistics of arrays of numbers, for many arrays at a time.

``generic`` reduces them to windows and topics; ``topic_pairs`` compares topics by them.
"""

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.plugin import RawRecord, Request
from oracle_pipeline.features.reduction import row_medians

Floats: TypeAlias = NDArray[np.float64]

STATISTICS = ("non_finite", "at_limit", "distinct", "autocorrelation", "roughness")

_EVERY_S = 0.1  # between the sampled arrays
_BLOCK = 2**16  # numbers per batch
_SHORTEST, _LONGEST = 16, 2048  # numbers; shorter arrays are channels, not samples of one quantity


def array_of(record: RawRecord) -> NDArray[np.floating[Any]] | None:
    """Return the array of a message, or the middle of a long one; None if it is too short.

    It is a copy of the same precision as the message, to save memory.
    """
    array = record.array
    if array is None or array.size < _SHORTEST:
        return None
    first = max(0, (array.size - _LONGEST) // 2)
    return array[first : first + _LONGEST].astype(array.dtype.newbyteorder("="))


#: Request of plugins that look into arrays: ten messages per second of each topic with arrays.
ARRAYS = Request(
    array_of, dtype=object, optional=True, raw=True, every_s=_EVERY_S, needs_array=True
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
    arrays = arrays.astype(np.float64, copy=False)
    finite = np.isfinite(arrays)
    numbers = np.where(finite, arrays, np.nan)
    count = finite.sum(axis=1)
    ordered = np.sort(numbers, axis=1)  # NaN last
    largest = ordered[np.arange(len(arrays)), np.maximum(count, 1) - 1]
    at_limit = (numbers == ordered[:, :1]) | (numbers == largest[:, np.newaxis])
    distinct = (np.diff(ordered, axis=1) > 0.0).sum(axis=1) + 1
    columns = (
        1.0 - count / arrays.shape[1],
        _over(at_limit.sum(axis=1), count),
        _over(distinct, count),
        _autocorrelation(numbers, count),
        roughness(arrays),
    )
    return np.stack(columns, axis=1)


def roughness(arrays: NDArray[np.floating[Any]]) -> Floats:
    """Return the median of abs(a[i-1] - 2 a[i] + a[i+1]) / abs(a[i]) of each row, shape (n,).

    Zeros and neighbours of non-finite numbers are left out; NaN if all numbers are.
    """
    arrays = arrays.astype(np.float64, copy=False)
    numbers = np.where(np.isfinite(arrays), arrays, np.nan)
    size = np.abs(numbers[:, 1:-1])
    bend = np.abs(numbers[:, :-2] - 2.0 * numbers[:, 1:-1] + numbers[:, 2:])
    return row_medians(_over(bend, size))


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


def _autocorrelation(numbers: Floats, count: NDArray[np.int64]) -> Floats:
    mean = _over(np.nansum(numbers, axis=1), count)
    apart = numbers - mean[:, np.newaxis]
    current, following = apart[:, :-1], apart[:, 1:]
    power = (
        np.where(np.isnan(current * following), 0.0, current**2 + following**2).sum(axis=1) / 2.0
    )
    return _over(np.nansum(current * following, axis=1), power)


def _over(values: NDArray[Any], others: NDArray[Any]) -> Floats:
    """Divide; NaN by zero."""
    quotient = np.full(np.broadcast_shapes(values.shape, others.shape), np.nan)
    np.divide(values, others, out=quotient, where=others > 0.0)
    return quotient
