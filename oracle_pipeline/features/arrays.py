"""Statistics of arrays of numbers, for many arrays at a time.

``generic`` reduces them to windows and topics; ``topic_pairs`` compares topics by them.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.plugin import RawRecord, Request
from oracle_pipeline.features.reduction import row_medians

Floats: TypeAlias = NDArray[np.float64]

STATISTICS = ("non_finite", "at_limit", "distinct", "autocorrelation", "roughness")

_EVERY_S = 0.1  # between the arrays that are looked at
_SHORTEST, _LONGEST = 16, 2048  # numbers; fewer are channels rather than a row of equals


def array_of(record: RawRecord) -> Floats | None:
    """Return the array of a message, of a long one the middle; None if it is no row of equals."""
    array = record.array
    if array is None or array.size < _SHORTEST:
        return None
    first = max(0, (array.size - _LONGEST) // 2)
    return array[first : first + _LONGEST].astype(np.float64)


#: Request of plugins that look into arrays: ten messages per second of each topic with arrays.
ARRAYS = Request(
    array_of, dtype=object, optional=True, raw=True, every_s=_EVERY_S, needs_array=True
)


def each(arrays: NDArray[np.object_], function: Callable[[Floats], Any]) -> list[Any]:
    """Call a function of equally long arrays, shape (n, m), and return a result for each array."""
    lengths = np.array([array.size for array in arrays])
    results: list[Any] = [None] * len(arrays)
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        for row, result in zip(rows, function(np.stack(list(arrays[rows]))), strict=True):
            results[row] = result
    return results


def statistics(arrays: Floats) -> Floats:
    """Return the ``STATISTICS`` of each row, shape (n, 5), NaN where too few numbers are finite.

    They are the share of inf and NaN; of the finite numbers the share that equals the largest or
    the smallest, the share of distinct ones and the correlation with their next; the roughness.
    """
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


def roughness(arrays: Floats) -> Floats:
    """Return the median of abs(a[i-1] - 2 a[i] + a[i+1]) / abs(a[i]) of each row, shape (n,).

    Zeros have none, nor has what is beside something that is not finite; NaN if nothing has.
    """
    numbers = np.where(np.isfinite(arrays), arrays, np.nan)
    size = np.abs(numbers[:, 1:-1])
    bend = np.abs(numbers[:, :-2] - 2.0 * numbers[:, 1:-1] + numbers[:, 2:])
    return row_medians(_over(bend, size))


def standard_ranks(arrays: Floats) -> Floats:
    """Return ranks in each row, less their mean, as vectors of length one; ties share theirs.

    The product of two is Spearman's correlation; equal numbers are all zero. NaN ranks as ``inf``.
    """
    ranks = _ranks(np.where(np.isnan(arrays), np.inf, arrays))
    ranks -= ranks.mean(axis=1, keepdims=True)
    length = np.linalg.norm(ranks, axis=1, keepdims=True)
    np.divide(ranks, length, out=ranks, where=length > 0.0)
    return ranks


def _ranks(arrays: Floats) -> Floats:
    """Return ranks in each row from 1 on, equal numbers sharing the mean of theirs.

    It is ``scipy.stats.rankdata``, whose import takes longer than most recordings.
    """
    order = np.argsort(arrays, axis=1, kind="stable")
    ordered = np.take_along_axis(arrays, order, axis=1)
    begins = np.ones(arrays.shape, dtype=np.bool_)
    begins[:, 1:] = ordered[:, 1:] != ordered[:, :-1]
    firsts = np.flatnonzero(begins)
    sizes = np.diff(firsts, append=arrays.size)
    shared = firsts % arrays.shape[1] + (sizes + 1) / 2.0
    ranks = np.empty(arrays.shape)
    np.put_along_axis(ranks, order, np.repeat(shared, sizes).reshape(arrays.shape), axis=1)
    return ranks


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
