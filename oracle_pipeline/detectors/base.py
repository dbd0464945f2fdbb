"""The interface of all detectors: fit on normal runs only, and score each run independently."""

import functools
from contextlib import AbstractContextManager
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, OutlierMixin
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import ThreadpoolController

from oracle_pipeline.bags.errors import OracleError


class DetectorError(OracleError):
    """A detector cannot be fitted on these rows."""


class Detector(Protocol):
    """The interface that all detectors of the panel share, ours and scikit-learn's."""

    def fit(self, X: ArrayLike, y: None = None) -> Self:
        """Learn what normal runs look like, shape (n_runs, n_features), scaled and finite."""

    def score_samples(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return one score per row, independent of other rows; higher is more normal."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters of the constructor."""


_libraries = functools.cache(ThreadpoolController)  # it searches what is loaded


def single_threaded() -> AbstractContextManager[object]:
    """Limit linear algebra to one thread: several are slower on the matrices of few runs."""
    limited: AbstractContextManager[object] = _libraries().limit(limits=1, user_api="blas")
    return limited


def shrinkage(centred: NDArray[np.float64], trace: float, squares: float) -> float:
    """Return the share of Ledoit and Wolf's target in the covariance of centred rows.

    Parameters
    ----------
    centred : ndarray of shape (n_rows, n_columns)
    trace, squares : float
        Sums of the variances, and of the squares of all elements of the sample covariance.

    References
    ----------
    O. Ledoit, M. Wolf, "A well-conditioned estimator for large-dimensional covariance matrices",
    Journal of Multivariate Analysis 88, 2004.
    """
    rows, columns = centred.shape
    powers = np.einsum("ij,ij->i", centred, centred)
    unequal = squares - trace**2 / columns  # 0 if the covariance is the target
    noise = (float(powers @ powers) / rows - squares) / rows
    return min(max(noise / unequal, 0.0), 1.0) if unequal > 0.0 else 0.0


class OwnDetector(OutlierMixin, BaseEstimator):  # type: ignore[misc]  # untyped bases
    """Base of detectors that scikit-learn lacks; it validates the input for subclasses.

    There is no ``predict``: thresholds come from runs that the detector was not fitted on.
    """

    def fit(self, X: ArrayLike, y: None = None) -> Self:  # noqa: ARG002  # scikit-learn passes it
        """Learn what normal runs look like, shape (n_runs, n_features), scaled and finite."""
        rows = validate_data(self, X, dtype=np.float64)
        if len(rows) < 2:
            raise DetectorError("A single run has no spread; fit the detector on at least two.")
        self._learn(rows)
        return self

    def score_samples(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return one score per row, independent of other rows; higher is more normal."""
        check_is_fitted(self)
        return -self._distance(validate_data(self, X, dtype=np.float64, reset=False))

    def _learn(self, X: NDArray[np.float64]) -> None:
        raise NotImplementedError

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        raise NotImplementedError
