"""Statistics of signals over a span of time: level, spread, range, change, and how they change."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.datasets import SIGNALS, is_lag
from oracle_pipeline.features.engine.plugin import Feature
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.signals.collector import PERIOD, Adjacent, Floats, Signals
from oracle_pipeline.features.signals.control_errors import control_errors
from oracle_pipeline.features.signals.rate_errors import rate_errors
from oracle_pipeline.features.signals.units import period_of

FEWEST = 4  # numbers of a signal that has more than a level
ROUNDING = 1e-7  # of the largest magnitude: smaller deviations are rounding errors
LEAST_LAG_S = 0.01  # which another machine adds, too
FEWEST_HELD = 30  # numbers of a signal that can stand still

_IN_UNIT = {
    "mean": "mean", "std": "standard deviation", "min": "minimum", "max": "maximum",
    "change": "mean magnitude of the change from one message to the next",
}  # fmt: skip
_PURE = {  # description, and smallest difference that means something
    "autocorrelation": ("correlation of a value with the next", 0.15),
    "held": ("longest share of the messages without a change", 0.05),
    "missing": ("share of the messages without a finite value", 0.01),
}
OF_RUN = (*_IN_UNIT, *_PURE)
OF_WINDOW = ("mean", "std", "change")
OF_STEPS = ("change", "autocorrelation", "held")  # others where messages are lost
_LEVELS = [0, 2, 3]  # places of mean, minimum and maximum
_ROWS_OF_WINDOW = [OF_RUN.index(statistic) for statistic in OF_WINDOW]
_COUNTED = {"seq", "count", "counter", "timestamp", "time", "ticks"}  # last words of names


class SignalTable:
    """The statistics of the signals of a recording.

    Parameters
    ----------
    signals : list of Signals

    Attributes
    ----------
    features, of_windows : dict of str to Feature
        By column of the table of runs, and of that of windows.
    """

    def __init__(self, signals: list[Signals]) -> None:
        prepared = [_as_they_are(each) for each in signals]
        of_rates = rate_errors(each for each, _ in prepared)
        prepared += [*control_errors(prepared), *((each, np.zeros(1)) for each in of_rates)]
        self._signals = [each for each, _ in prepared]
        self._periods = [periods for _, periods in prepared]
        features = [
            (f"{SIGNALS}{each.topic}/{name}.{statistic}", _feature(name, statistic, unit))
            for each in self._signals
            for name, unit in zip(each.names, each.units, strict=True)
            for statistic in OF_RUN
        ]
        self.features = dict(features)
        self._columns = [column for column, _ in features]  # two signals may have one name
        self._window_columns = [c for c in self._columns if c.rpartition(".")[2] in OF_WINDOW]
        self.of_windows = {column: self.features[column] for column in self._window_columns}

    def values(self, span: Span, *, per_window: bool = False) -> dict[str, float]:
        """Return the statistics of a span by column; NaN where a signal has too few numbers."""
        rows = _ROWS_OF_WINDOW if per_window else slice(None)
        found = [
            _within_a_turn(_statistics(*_in_span(span, each), of_run=not per_window), periods)[rows]
            for each, periods in zip(self._signals, self._periods, strict=True)
        ]
        numbers = np.concatenate([each.T.ravel() for each in found]) if found else np.empty(0)
        numbers[np.isinf(numbers)] = np.nan  # of numbers whose squares overflow
        columns = self._window_columns if per_window else self._columns
        return dict(zip(columns, numbers.tolist(), strict=True))


def _feature(name: str, statistic: str, unit: str) -> Feature:
    timing = statistic in OF_STEPS or is_lag(name)
    if statistic in _IN_UNIT:
        floor = LEAST_LAG_S if is_lag(name) else math.nan
        return Feature(name, unit, floor, f"{_IN_UNIT[statistic]} of the field", timing=timing)
    words, floor = _PURE[statistic]
    return Feature(name, "1", floor, f"{words}, of the field", timing=timing)


def _as_they_are(signals: Signals) -> tuple[Signals, Floats]:
    """Return angles without jumps of a turn, and counters as their rates; and the turns.

    What stands still has a level, too: it may be a number of things.
    """
    if signals.names == (PERIOD,):
        return signals, np.zeros(1)  # no copy of what may be millions
    found: list[tuple[str, str, Floats, float]] = []
    for name, unit, column in zip(signals.names, signals.units, signals.values.T, strict=True):
        numbers = column[np.isfinite(column)]
        period = period_of(name, unit, float(np.abs(numbers).max(initial=0.0)))
        if period:
            column = column.copy()
            column[np.isfinite(column)] = np.unwrap(numbers, period=period)
        elif _may_count(name, numbers):
            found.append((f"{name}.rate", "1/s", _rates(column, signals.times_ns), 0.0))
            if numbers[-1] > numbers[0]:
                continue
        found.append((name, unit, column, period))
    names, units, columns, periods = zip(*found, strict=True)
    whole = signals._replace(names=names, units=units, values=np.column_stack(columns))
    return whole, np.array(periods)


def _within_a_turn(found: Floats, periods: Floats) -> Floats:
    """Return the statistics of angles with a mean of at most half a turn."""
    turns = np.zeros(len(periods))
    np.divide(found[0], periods, out=turns, where=periods > 0.0)
    found[_LEVELS] -= periods * np.round(turns)
    return found


def _may_count(name: str, values: Floats) -> bool:
    last = name.rpartition(".")[2].rpartition("_")[2].lower()
    return len(values) >= FEWEST and last in _COUNTED and bool((np.diff(values) >= 0.0).all())


def _rates(values: Floats, times_ns: NDArray[np.int64]) -> Floats:
    seconds = np.diff(times_ns) * 1e-9
    rates = np.full(len(values), np.nan)
    np.divide(np.diff(values), seconds, out=rates[1:], where=seconds > 0.0)
    return rates


def _in_span(span: Span, signals: Signals) -> tuple[Floats, Adjacent]:
    """Return the numbers of a span, and which of them are adjacent to the one before."""
    part = span.slice_of(signals.times_ns)
    adjacent = None if signals.adjacent is None else signals.adjacent[part]
    tells = adjacent is not None and adjacent[1:].any()
    return signals.values[part], adjacent if tells else None


def _statistics(values: Floats, adjacent: Adjacent, *, of_run: bool) -> Floats:
    """Return the statistics of each column, shape (len(OF_RUN), n_columns)."""
    found = np.full((len(OF_RUN), values.shape[1]), np.nan)
    if not len(values):
        return found
    finite = np.isfinite(values)
    found[-1] = 1.0 - finite.mean(axis=0)
    whole = finite.all(axis=0)
    # One column may have millions of numbers. Of several, a copy is faster to sum.
    chosen = values if finite.all() and values.shape[1] == 1 else values[:, whole]
    found[:-1, whole] = _of_finite(chosen, adjacent, of_run)
    for j in np.flatnonzero(~whole & finite.any(axis=0)).tolist():
        rows = finite[:, j]
        near = None if adjacent is None else adjacent[rows]
        found[:-1, j] = _of_finite(values[rows, j][:, np.newaxis], near, of_run)[:, 0]
    return found


def _of_finite(values: Floats, adjacent: Adjacent, of_run: bool) -> Floats:
    """Return all statistics but the last of columns of finite numbers.

    A few numbers have a level only, and one has only a mean, so that what is published once counts
    too. The last two are of runs only. Change and autocorrelation are those of adjacent messages.
    """
    mean, low, high = values.mean(axis=0), values.min(axis=0), values.max(axis=0)
    unknown = np.full(len(mean), np.nan)
    if len(values) < FEWEST:
        ends = [low, high] if len(values) > 1 else [unknown] * 2
        return np.stack([mean, unknown, *ends, *[unknown] * 3])
    near = slice(None) if adjacent is None else adjacent[1:]
    steps = values[1:] - values[:-1]
    change = np.abs(steps[near]).mean(axis=0)
    held = np.array([*_held(steps)]) if of_run else unknown
    del steps  # of millions, before as many more are made
    centred = values - mean
    deviation = np.sqrt(squares := (centred * centred).mean(axis=0))
    is_constant = deviation <= ROUNDING * np.maximum(np.abs(low), np.abs(high))
    spread, changes = np.where(is_constant, 0.0, [deviation, change])
    if not of_run:
        return np.stack([mean, spread, low, high, changes, *[unknown] * 2])
    products = (centred[1:] * centred[:-1])[near]
    correlation = products.sum(axis=0) / (squares * (len(products) + 1))
    correlation = np.where(is_constant, 1.0, correlation)
    return np.stack([mean, spread, low, high, changes, correlation, held])


def _held(steps: Floats) -> Iterator[float]:
    """Yield the longest share of the messages without a change, for each column."""
    count = len(steps) + 1
    for column in steps.T:
        changes = np.flatnonzero(column)
        longest = np.diff(changes, prepend=-1, append=len(steps)).max()
        yield float(longest / count) if count >= FEWEST_HELD else math.nan
