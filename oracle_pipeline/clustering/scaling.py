"""Scales features of different units, without labels.

A scikit-learn transformer, so that it can be fitted on one set of runs and applied to another.
"""

from collections.abc import Mapping
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin

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
        values = _finite(X)
        counts = np.count_nonzero(~np.isnan(values), axis=1)
        names = np.array(list(X.columns), dtype=object)
        self.kept_ = names[counts > 0].tolist()
        self.dropped_ = names[counts == 0].tolist()
        self.indicated_ = names[(counts > 0) & (counts < len(X))].tolist()

        values, counts = values[counts > 0], counts[counts > 0]
        self.center_ = _medians(values, counts)
        deviation = MAD_TO_DEVIATION * _medians(np.abs(values - self.center_[:, None]), counts)
        floors = self.floors or {}
        floor = np.array([floors.get(name, np.nan) for name in self.kept_], dtype=np.float64)
        undeclared = np.isnan(floor)
        floor[undeclared] = SPREAD_FLOOR * _deviations(values[undeclared], counts[undeclared])
        rounding = ROUNDING_FLOOR * np.fmax.reduce(np.abs(values), axis=1, initial=0.0)
        scale = np.maximum.reduce([deviation, floor, rounding])
        self.scale_ = np.where(scale > 0.0, scale, self.of_zero)
        return self

    def transform(self, X: pd.DataFrame) -> NDArray[np.float64]:
        """Return the scaled features, shape (n_runs, len(kept_) + len(indicated_)), without NaN."""
        values = _finite(X if list(X.columns) == self.kept_ else X[self.kept_])
        indicated = np.isin(self.kept_, self.indicated_)
        kept = len(self.kept_)
        scaled = np.empty((len(X), kept + len(self.indicated_)))
        scaled[:, :kept] = ((values - self.center_[:, None]) / self.scale_[:, None]).T
        scaled[:, kept:] = np.isnan(values[indicated]).T
        np.clip(scaled, -CLIP, CLIP, out=scaled)
        return np.nan_to_num(scaled, copy=False, nan=0.0)


def _finite(X: pd.DataFrame) -> NDArray[np.float64]:
    """Return the values, one row per column of `X`, with NaN where they are not finite."""
    values = X.to_numpy(dtype=np.float64).T
    return np.ascontiguousarray(np.where(np.isfinite(values), values, np.nan))


def _medians(values: NDArray[np.float64], counts: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the median of the numbers in each row; `counts` is their number, without NaN."""
    ordered, row = np.sort(values, axis=1), np.arange(len(values))  # NaN comes last
    middle = (ordered[row, (counts - 1) // 2] + ordered[row, counts // 2]) / 2.0
    return np.asarray(middle, dtype=np.float64)


def _deviations(values: NDArray[np.float64], counts: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the standard deviation of the numbers in each row."""
    centred = values - (np.nansum(values, axis=1) / counts)[:, None]
    return np.asarray(np.sqrt(np.nansum(centred * centred, axis=1) / counts), dtype=np.float64)
