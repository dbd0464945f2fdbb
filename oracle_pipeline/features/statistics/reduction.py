"""From numbers per message to one per window, and from one per topic to the largest of all.

What a plugin's ``prepare`` computes is kept as `Series` over the whole recording, so that a
window is a slice of it.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine.plugin import Located, Missing, Series, Window
from oracle_pipeline.features.engine.spans import between

MAD_TO_DEVIATION = 1.4826  # of a normal distribution


def within(times_s: NDArray[np.float64], window: Window) -> slice:
    """Return the slice of ascending times that is in a window."""
    return slice(*between(times_s, window.start_s, window.end_s))


def quantile(series: Series, window: Window, q: float) -> float:
    """Return a quantile of the numbers in a window, as ``np.quantile``; NaN if there is none.

    A window has few numbers, for which the library's checks take ten times as long as its sums.
    """
    return _quantile_between(*series, window.start_s, window.end_s, q)


@jit
def _quantile_between(
    times_s: NDArray[np.float64],
    values: NDArray[np.float64],
    start_s: float,
    end_s: float,
    q: float,
) -> float:
    first, after = between(times_s, start_s, end_s)
    return quantile_of(values[first:after], q)


@jit
def quantile_of(values: NDArray[np.float64], q: float) -> float:
    """Return a quantile of some numbers without the NaN ones; NaN if there is no other."""
    ordered = np.sort(values[~np.isnan(values)])
    last = len(ordered) - 1
    if last < 0:
        return math.nan
    low = int(q * last)
    below, above = float(ordered[low]), float(ordered[min(low + 1, last)])
    return below + (q * last - low) * (above - below)


@jit
def median_and_deviation(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the median of some numbers, none of them NaN, and their median distance from it."""
    middle = np.median(values)
    return middle, np.median(np.abs(values - middle))


@jit
def column_medians(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of each column's numbers, NaN if a column has none; shape (m,)."""
    medians = np.full(values.shape[1], np.nan)
    for j in range(values.shape[1]):
        known = values[:, j][~np.isnan(values[:, j])]
        if len(known):
            medians[j] = np.median(known)
    return medians


def mean(series: Series, window: Window) -> float:
    """Return the mean of the numbers in a window; NaN if there is none."""
    values = series.values[within(series.times_s, window)]
    values = values[~np.isnan(values)]
    return float(np.add.reduce(values) / values.size) if values.size else math.nan


def largest(by_place: Mapping[str, float], reason: str) -> Located | Missing:
    """Return the largest number and its place, ignoring NaN; `Missing` without any."""
    places = {place: value for place, value in by_place.items() if not math.isnan(value)}
    if not places:
        return Missing(reason)
    where = max(places, key=places.__getitem__)
    return Located(places[where], where)


def smallest(by_place: Mapping[str, float], reason: str) -> Located | Missing:
    """Return the smallest number and its place, ignoring NaN; `Missing` without any."""
    negated = largest({place: -value for place, value in by_place.items()}, reason)
    return Located(-negated.value, negated.where) if isinstance(negated, Located) else negated


def row_medians(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of each row's numbers, NaN if a row has none; shape (n,)."""
    return _middles(np.sort(values, axis=1))  # NaN last


@jit
def _middles(ordered: NDArray[np.float64]) -> NDArray[np.float64]:
    middles = np.full(len(ordered), np.nan)
    for i in range(len(ordered)):
        last = ordered.shape[1] - 1
        while last >= 0 and np.isnan(ordered[i, last]):
            last -= 1
        if last >= 0:
            middles[i] = 0.5 * (ordered[i, last // 2] + ordered[i, (last + 1) // 2])
    return middles
