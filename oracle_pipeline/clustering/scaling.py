"""Scales features of different units, without labels.

A scikit-learn transformer, so that it can be fitted on one set of runs and applied to another.
"""

from collections.abc import Mapping
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin

from oracle_pipeline.bags.jit import jit_unchecked

MAD_TO_DEVIATION = 1.4826  # of a normal distribution
SPREAD_FLOOR = 0.1  # floor without a declared resolution, in standard deviations of the column
ROUNDING_FLOOR = 1e-9  # floor for every column, relative to its largest magnitude
CLIP = 50.0  # limit of a single feature's influence [scales]


class FlooredRobustScaler(TransformerMixin, BaseEstimator):  # type: ignore[misc]  # untyped base
    """Scale each column to ``(x - median) / max(1.4826 MAD, floor)``, clipped to +-50.

    MAD is the median distance from the median. It tolerates attacked runs up to one half, the
    interquartile range only up to a quarter.

    The floor prevents a column that is constant except for rounding or a few runs from dominating
    all others. It is the declared measurement resolution, else a tenth of the column's standard
    deviation, and never below rounding error. A constant column becomes 0.

    Values that are not finite count as missing and become the median. Every column with missing
    values in the fitted data gets an indicator column (1 missing, 0 not) after the features. A
    column without any value is dropped and listed in ``dropped_``.

    Parameters
    ----------
    floors : mapping of str to float, optional
        Resolution of a column, in its unit.

    Attributes
    ----------
    kept_ : list of str
        Columns that are scaled.
    dropped_ : list of str
        Columns without a finite value.
    indicated_ : list of str
        Columns that get an indicator.
    center_, scale_ : ndarray of shape (len(kept_),)
        In each column's unit.
    """

    of_zero = 1.0  # scale of a column that is always 0 and has no floor, in its unit

    def __init__(self, floors: Mapping[str, float] | None = None) -> None:
        self.floors = floors

    def fit(self, X: pd.DataFrame, y: None = None) -> Self:  # noqa: ARG002  # scikit-learn passes it
        """Learn centre and scale from the rows of `X`, shape (n_runs, n_features)."""
        statistics = _statistics(_columns(X))
        counts, names = statistics[0], np.array(list(X.columns), dtype=object)
        self.kept_ = names[counts > 0].tolist()
        self.dropped_ = names[counts == 0].tolist()
        self.indicated_ = names[(counts > 0) & (counts < len(X))].tolist()

        _, self.center_, mad, deviation, largest = statistics[:, counts > 0]
        floors = self.floors or {}
        floor = np.array([floors.get(name, np.nan) for name in self.kept_], dtype=np.float64)
        floor = np.where(np.isnan(floor), SPREAD_FLOOR * deviation, floor)
        scale = np.maximum.reduce([MAD_TO_DEVIATION * mad, floor, ROUNDING_FLOOR * largest])
        self.scale_ = np.where(scale > 0.0, scale, self.of_zero)
        self._adjust(mad, deviation)
        return self

    def _adjust(self, mad: NDArray[np.float64], deviation: NDArray[np.float64]) -> None:
        """Change what was learned; the MAD and the standard deviation of the columns are given."""

    def transform(self, X: pd.DataFrame) -> NDArray[np.float64]:
        """Return the scaled features, shape (n_runs, len(kept_) + len(indicated_)), without NaN."""
        values = _columns(X if list(X.columns) == self.kept_ else X[self.kept_])
        kept = len(self.kept_)
        scaled = np.empty((kept + len(self.indicated_), len(X)))
        _scale(values, self.center_, self.scale_, self._limits(), scaled)
        scaled[kept:] = ~np.isfinite(values[np.isin(self.kept_, self.indicated_)])
        return scaled.T

    def _limits(self) -> NDArray[np.float64]:
        """Return the largest distance that counts, for each kept column [scales]."""
        return np.full(len(self.kept_), CLIP)


def _columns(X: pd.DataFrame) -> NDArray[np.float64]:
    """Return the values, one row per column of `X`."""
    return np.ascontiguousarray(X.to_numpy(dtype=np.float64).T)


@jit_unchecked
def _statistics(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return statistics of the finite numbers in each row, shape (5, n_rows).

    They are their count, median, MAD, standard deviation and largest magnitude.
    """
    found = np.full((5, len(values)), np.nan)
    for row in range(len(values)):
        numbers = values[row][np.isfinite(values[row])]
        found[0, row] = len(numbers)
        if len(numbers):
            found[1, row] = np.median(numbers)
            found[2, row] = np.median(np.abs(numbers - found[1, row]))
            found[3, row] = np.std(numbers)
            found[4, row] = np.abs(numbers).max()
    return found


@jit_unchecked
def _scale(
    values: NDArray[np.float64],
    center: NDArray[np.float64],
    scale: NDArray[np.float64],
    limit: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write the scaled rows of `values` into the first rows of `out`; 0 where they are missing."""
    for row in range(len(values)):
        scaled = np.clip((values[row] - center[row]) / scale[row], -limit[row], limit[row])
        out[row] = np.where(np.isfinite(values[row]) & ~np.isnan(scaled), scaled, 0.0)
