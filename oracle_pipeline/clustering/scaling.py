"""Bring features of different units to one scale, without labels.

A scikit-learn transformer, so that it can be fitted on one set of runs and applied to another.
"""

from collections.abc import Mapping
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin

MAD_TO_DEVIATION = 1.4826  # of a normal distribution
SPREAD_FLOOR = 0.1  # floor where no resolution is declared, in standard deviations of the column
ROUNDING_FLOOR = 1e-9  # floor for every column, as a share of its largest magnitude
CLIP = 50.0  # limit of a single feature's influence [scales]


class FlooredRobustScaler(TransformerMixin, BaseEstimator):  # type: ignore[misc]  # untyped base
    """Scale each column to ``(x - median) / max(1.4826 MAD, floor)``, clipped to +-50.

    MAD is the median distance from the median: unlike the interquartile range it ignores the
    attacked runs as long as they are fewer than half, not only as long as they are a quarter.

    The floor keeps a column that is constant but for rounding or for a run or two from swamping all
    others: it is the declared measurement resolution, else a tenth of the column's standard
    deviation, and never below rounding error. A column that does not vary at all becomes 0.

    Values that are not finite count as missing: they become the median, and every column with some
    missing in the fitted data gets an indicator column (1 missing, 0 not) after the features. A
    column with nothing but missing values is dropped and named in ``dropped_``.

    Parameters
    ----------
    floors : mapping of str to float, optional
        Resolution of a column, in its unit.

    Attributes
    ----------
    kept_ : list of str
        Columns that are scaled.
    dropped_ : list of str
        Columns without one finite value.
    indicated_ : list of str
        Columns that get an indicator.
    center_, scale_ : ndarray of shape (len(kept_),)
        In each column's unit.
    """

    def __init__(self, floors: Mapping[str, float] | None = None) -> None:
        self.floors = floors

    def fit(self, X: pd.DataFrame, y: None = None) -> Self:  # noqa: ARG002  # scikit-learn passes it
        """Learn centre and scale from the rows of `X`, shape (n_runs, n_features)."""
        share_finite = _finite(X).notna().mean()
        self.kept_ = list(share_finite.index[share_finite > 0.0])
        self.dropped_ = list(share_finite.index[share_finite == 0.0])
        self.indicated_ = list(share_finite.index[(share_finite > 0.0) & (share_finite < 1.0)])

        values = _finite(X[self.kept_])
        center = values.median()
        deviation = MAD_TO_DEVIATION * (values - center).abs().median().to_numpy()
        resolution = pd.Series(self.floors or {}, dtype=np.float64).reindex(self.kept_)
        floor = resolution.fillna(SPREAD_FLOOR * values.std(ddof=0)).to_numpy()
        rounding = ROUNDING_FLOOR * values.abs().max().to_numpy()
        scale = np.maximum.reduce([deviation, floor, rounding])
        self.center_ = center.to_numpy()
        self.scale_ = np.where(scale > 0.0, scale, 1.0)
        return self

    def transform(self, X: pd.DataFrame) -> NDArray[np.float64]:
        """Return shape (n_runs, len(kept_) + len(indicated_)), without unit and without NaN."""
        values = _finite(X[self.kept_]).to_numpy()
        scaled = np.clip((values - self.center_) / self.scale_, -CLIP, CLIP)
        indicators = _finite(X[self.indicated_]).isna().to_numpy()
        return np.hstack([np.nan_to_num(scaled, nan=0.0), indicators])


def _finite(X: pd.DataFrame) -> pd.DataFrame:
    """Return the values as float64, NaN where they are not finite."""
    values = X.astype(np.float64)
    return values.where(np.isfinite(values))
