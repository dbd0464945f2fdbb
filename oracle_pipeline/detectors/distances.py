"""Detectors based on the distance of a run from the normal ones."""

import numpy as np
from numpy.typing import NDArray
from sklearn.decomposition import PCA

from oracle_pipeline.detectors.base import OwnDetector, shrinkage

_LEAST_WIDTH = 1.0  # of a range [scales]
_MOST_WIDTHS = 3.0  # that one feature counts
_EXPLAINED = 0.95  # share of the variance that the principal components keep
_LEAST_USUAL = 1e-9  # so that rows without variance have a scale


class LargestZ(OwnDetector):
    """The mean of the largest absolute z-scores of single features.

    The rows are z-scores already (`FlooredRobustScaler`), so nothing is learned.

    Parameters
    ----------
    count : int
        Number of features that are averaged.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count

    def _learn(self, X: NDArray[np.float64]) -> None:
        """Learn nothing."""

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.sort(np.abs(X), axis=1)[:, -self.count :].mean(axis=1), np.float64)


class BeyondRange(OwnDetector):
    """How far features are beyond the range of normal runs, in widths of that range.

    The mean of the farthest few. In a distance from the mean, features that are spread among normal
    runs hide those that are not; here what a normal run has reached counts nothing.

    Parameters
    ----------
    count : int
        Number of features that are averaged.

    Attributes
    ----------
    low_, high_ : ndarray of shape (n_features,)
        The range.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count

    def _learn(self, X: NDArray[np.float64]) -> None:
        self.low_, self.high_ = X.min(axis=0), X.max(axis=0)

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        width = np.maximum(self.high_ - self.low_, _LEAST_WIDTH)
        widths = np.maximum(self.low_ - X, X - self.high_) / width
        counted = np.sort(np.clip(widths, 0.0, _MOST_WIDTHS), axis=1)[:, -self.count :]
        return np.asarray(counted.mean(axis=1), dtype=np.float64)


class PrincipalComponents(OwnDetector):
    """Hotelling's T2 and the squared residual Q, each over its mean among normal runs, added."""

    def _learn(self, X: NDArray[np.float64]) -> None:
        with np.errstate(invalid="ignore"):  # equal rows explain no share of no variance
            self.components_ = PCA(_EXPLAINED, svd_solver="full").fit(X)
        self.usual_ = np.maximum(self._parts(X).mean(axis=0), _LEAST_USUAL)

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((self._parts(X) / self.usual_).sum(axis=1), dtype=np.float64)

    def _parts(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return T2 and Q of each row, shape (n_rows, 2)."""
        along = self.components_.transform(X)
        beside = X - self.components_.inverse_transform(along)
        variance = np.maximum(self.components_.explained_variance_, _LEAST_USUAL)
        return np.column_stack([(along**2 / variance).sum(axis=1), (beside**2).sum(axis=1)])


class Mahalanobis(OwnDetector):
    """Distance from the mean in the covariance of normal runs, shrunk after Ledoit and Wolf.

    Rows are z-scores in units of at least the feature's resolution. Variances below 1 are raised to
    1, so a feature that never varied in training is neither ignored nor dominates all others.

    Attributes
    ----------
    location_ : ndarray of shape (n_features,)
    precision_ : ndarray of shape (n_features, n_features)
    """

    def _learn(self, X: NDArray[np.float64]) -> None:
        self.location_ = X.mean(axis=0)
        centred = X - self.location_
        covariance = centred.T @ centred / len(X)
        trace = float(np.trace(covariance))
        weight = shrinkage(centred, trace, float((covariance**2).sum()))
        variances = (1.0 - weight) * np.diag(covariance) + weight * trace / X.shape[1]
        covariance *= 1.0 - weight
        np.fill_diagonal(covariance, np.maximum(variances, 1.0))
        inverse = np.linalg.inv(covariance).astype(np.float32)
        # Exactly symmetric and in single precision, because a reference card stores one half.
        self.precision_ = ((inverse + inverse.T) / 2).astype(np.float64)

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        deviation = X - self.location_
        squared = np.einsum("ij,ij->i", deviation @ self.precision_, deviation)
        return np.asarray(np.sqrt(squared), dtype=np.float64)
