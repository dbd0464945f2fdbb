"""scikit-learn's detectors with checks against their pitfalls."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.covariance import EllipticEnvelope
from sklearn.neighbors import LocalOutlierFactor
from sklearn.utils.validation import validate_data

from oracle_pipeline.detectors.base import DetectorError

ROWS_PER_FEATURE = 5  # with fewer, a minimum covariance determinant is mostly noise


class DistinctLocalOutlierFactor(LocalOutlierFactor):  # type: ignore[misc]  # untyped base
    """Local outlier factor over distinct rows.

    Copies of a row have infinite density, and every row beside them looks like an outlier
    (scikit-learn issue 27839). Copies carry no information, so they count once.
    """

    def fit(self, X: ArrayLike, y: None = None) -> Self:  # noqa: ARG002  # scikit-learn passes it
        """Learn from the distinct rows; `DetectorError` if there are not enough."""
        rows = np.unique(validate_data(self, X, dtype=np.float64), axis=0)
        if len(rows) <= self.n_neighbors:
            raise DetectorError(
                f"The local outlier factor needs more than {self.n_neighbors} distinct runs, there "
                f"are {len(rows)}; fit on more runs or lower n_neighbors."
            )
        fitted: Self = super().fit(rows)
        return fitted


class AmpleEllipticEnvelope(EllipticEnvelope):  # type: ignore[misc]  # untyped base
    """Minimum covariance determinant; raises an error for too few runs."""

    def fit(self, X: ArrayLike, y: None = None) -> Self:  # noqa: ARG002  # scikit-learn passes it
        """Learn the envelope; `DetectorError` unless there are five rows for each feature."""
        rows, features = validate_data(self, X, dtype=np.float64).shape
        if rows <= ROWS_PER_FEATURE * features:
            raise DetectorError(
                f"An elliptic envelope over {features} features needs more than "
                f"{ROWS_PER_FEATURE * features} runs, there are {rows}; fit on fewer features or "
                "use Mahalanobis, which shrinks the covariance."
            )
        fitted: Self = super().fit(X)
        return fitted
