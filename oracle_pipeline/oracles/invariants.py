"""Derived oracle: learns invariants of normal runs, after Daikon [1]_.

Candidates are the lower and upper bounds of a signal, of its rate of change, and of the difference
of two signals in the same unit. A bound that all normal runs kept is an invariant. Each is one line
of a file of requirements, so people can review, change or delete it, and ``specified`` can use the
remaining lines.

References
----------
.. [1] M. Ernst et al., "The Daikon system for dynamic detection of likely invariants", Science of
   Computer Programming 69, 2007.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.features.engine.plugin import hookimpl
from oracle_pipeline.oracles.kind import KindError, Maker, TracedRuns
from oracle_pipeline.oracles.requirements import FARTHEST, Requirement
from oracle_pipeline.oracles.traces import RATE, SIGNALS, TIME, values_of

HEAD = """Invariants of normal runs, in the manner of Daikon: bounds of signals, of their change in
one second (_rate), and of the difference of two signals with the same unit. These runs reached the
bounds, so a bound may hold only by chance. Delete or change lines as needed.
"""  # comment at the top of a file

_FEWEST = 3  # normal runs with the signal

_RELATIVE, _LEAST = 1e-3, 1e-6  # significant difference where none is known: of a bound, at least
_GROWING = {"travelled"}  # grows with the length of the run, so bounds are meaningless


@dataclass(frozen=True, slots=True)
class _Quantity:
    """The quantity of a candidate: a signal, a rate, or the difference of two signals."""

    first: str
    second: str = ""

    def __str__(self) -> str:
        """Return the expression as text of a formula."""
        return f"{self.first} - {self.second}" if self.second else self.first

    @property
    def floor(self) -> float:
        """The smallest significant difference, in its unit; 0 if it is unknown."""
        signal = SIGNALS.get(self.first.removesuffix(RATE))
        return signal.floor if signal else 0.0


@functools.cache
def _quantities(further: tuple[str, ...]) -> tuple[_Quantity, ...]:
    """Return the expressions of all candidates, those of further signals too."""
    bounded = [name for name in SIGNALS if name not in _GROWING]
    changing = [name for name in (*SIGNALS, *further) if f"{name}{RATE}" not in further]
    return (
        *map(_Quantity, (*bounded, *further)),
        *(_Quantity(f"{name}{RATE}") for name in changing),
        *(
            _Quantity(first, second)
            for first, second in combinations(bounded, 2)
            if SIGNALS[first].unit == SIGNALS[second].unit
        ),
    )


@dataclass(frozen=True, slots=True)
class _Extremes:
    """Returns least and largest value of each quantity of a trace; hashable, to be cached."""

    quantities: tuple[_Quantity, ...]

    def __call__(self, trace: pd.DataFrame) -> NDArray[np.float64]:
        """Return an array of shape (2, n_quantities); NaN where the trace lacks a signal."""
        two = [each for each in self.quantities if each.second]  # they come last
        values = values_of(trace, [each.first for each in self.quantities])
        values[:, -len(two) :] -= values_of(trace, [each.second for each in two])
        unknown = ~np.isfinite(values)
        least = np.where(unknown, np.inf, values).min(axis=0, initial=np.inf)
        largest = np.where(unknown, -np.inf, values).max(axis=0, initial=-np.inf)
        return np.where(np.isfinite(least), [least, largest], np.nan)


@dataclass(frozen=True, eq=False, slots=True)
class _LearnedInvariants:
    """Bounds that all normal runs kept; arrays of shape (n_quantities,), NaN without a bound.

    Attributes
    ----------
    low, high : ndarray
    low_scale, high_scale : ndarray
        Spread of the extremes of normal runs: the unit of a violation.
    runs : int
        Number of runs learned from.
    extremes : callable
        Returns those of a trace.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    low_scale: NDArray[np.float64]
    high_scale: NDArray[np.float64]
    runs: int
    extremes: _Extremes

    @np.errstate(over="ignore")
    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run's largest violation of an invariant, in scales."""
        least, largest = runs.each(self.extremes).transpose(1, 0, 2)
        beyond = np.hstack(
            [(self.low - least) / self.low_scale, (largest - self.high) / self.high_scale]
        )
        worst = np.nan_to_num(beyond, nan=-FARTHEST).max(axis=1)
        return np.asarray(np.clip(worst, -FARTHEST, FARTHEST), dtype=np.float64)

    def requirements(self) -> list[Requirement]:
        """Return the invariants as formulas, each with the bound rounded outwards."""
        return list(self._written())

    def _written(self) -> Iterator[Requirement]:
        says = f"Held in {self.runs} normal runs."
        for n, about in enumerate(self.extremes.quantities):
            name = str(about).replace(" - ", ".minus.")
            if about.second and 0.0 <= self.low[n] < about.floor:  # one signal is never smaller
                formula = f"always ({about.first} >= {about.second})"
                yield Requirement(f"{name}.low", formula, _scale(self.low_scale[n]), says)
            elif np.isfinite(self.low[n]):
                formula = f"always ({about} >= {_text(np.floor, self.low[n], self.low_scale[n])})"
                yield Requirement(f"{name}.low", formula, _scale(self.low_scale[n]), says)
            if np.isfinite(self.high[n]):
                formula = f"always ({about} <= {_text(np.ceil, self.high[n], self.high_scale[n])})"
                yield Requirement(f"{name}.high", formula, _scale(self.high_scale[n]), says)


def half_to_learn(normal: TracedRuns) -> NDArray[np.bool_]:
    """Return a mask of the runs of every second session; of all if there are few runs."""
    sessions = np.unique(normal.session)
    half = np.isin(normal.session, sessions[::2])
    return half if half.sum() >= _FEWEST <= (~half).sum() else np.ones_like(half)


class Invariants:
    """Learns bounds from normal runs."""

    name = "invariants"
    asks = "nothing, or a review"

    def learn(self, normal: TracedRuns) -> _LearnedInvariants:
        """Return the bounds that all normal runs kept.

        Raises
        ------
        KindError
            Fewer than three normal runs.
        """
        if len(normal.traces) < _FEWEST:
            raise KindError(
                f"Invariants need at least {_FEWEST} normal runs, but there are "
                f"{len(normal.traces)}; record more."
            )
        further = [name for name in normal.traces[0] if name not in (TIME, *SIGNALS)]
        extremes = _Extremes(_quantities(tuple(further)))
        least, largest = normal.each(extremes).transpose(1, 0, 2)
        enough = np.isfinite(least).sum(axis=0) >= _FEWEST
        floors = np.array([each.floor for each in extremes.quantities])
        low, high = np.full((2, len(floors)), np.nan)
        low[enough] = np.nanmin(least[:, enough], axis=0)
        high[enough] = np.nanmax(largest[:, enough], axis=0)
        unknown = np.maximum(_RELATIVE * np.nan_to_num(np.maximum(abs(low), abs(high))), _LEAST)
        floors = np.where(floors > 0.0, floors, unknown)
        low_scale, high_scale = (np.maximum(_spread(each), floors) for each in (least, largest))
        runs = len(normal.traces)
        return _LearnedInvariants(low, high, low_scale, high_scale, runs, extremes)


@hookimpl
def register_oracles() -> list[Maker]:
    """Register the oracle of learned invariants."""
    return [lambda _: Invariants()]


def _spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the scaled MAD of each column; 0 for one without values."""
    known = np.isfinite(values).any(axis=0)
    spread = np.zeros(values.shape[1])
    deviation = np.abs(values[:, known] - np.nanmedian(values[:, known], axis=0))
    spread[known] = MAD_TO_DEVIATION * np.nanmedian(deviation, axis=0)
    return spread


def _scale(spread: float) -> float:
    """Return a scale as a person would write it."""
    return float(f"{spread:.4g}")


def _text(rounded: np.ufunc, bound: float, scale: float) -> str:
    """Return a bound with four decimals or more, if its scale is small, rounded outwards."""
    decimals = max(4, 1 - math.floor(math.log10(scale)))
    return f"{rounded(bound * 10.0**decimals) / 10.0**decimals:.{decimals}f}"
