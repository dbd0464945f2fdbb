"""Detectors based on the distance of a run from the normal ones."""

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import LedoitWolf
from sklearn.neighbors import NearestNeighbors

from oracle_pipeline.detectors.base import DetectorError, OwnDetector


class MaxZ(OwnDetector):
    """The largest absolute z-score of any single feature.

    The rows are z-scores already (`FlooredRobustScaler`), so nothing is learned.
    """

    def _learn(self, X: NDArray[np.float64]) -> None:
        """Learn nothing."""

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.abs(X).max(axis=1), dtype=np.float64)


class Mahalanobis(OwnDetector):
    """Distance from the mean in the covariance of normal runs, shrunk after Ledoit and Wolf [1]_.

    Rows are z-scores in units of at least the feature's resolution. Variances below 1 are raised to
    1, so a feature that never varied in training is neither ignored nor dominates all others.

    Attributes
    ----------
    location_ : ndarray of shape (n_features,)
    precision_ : ndarray of shape (n_features, n_features)

    References
    ----------
    .. [1] O. Ledoit, M. Wolf, "A well-conditioned estimator for large-dimensional covariance
       matrices", Journal of Multivariate Analysis 88, 2004.
    """

    def _learn(self, X: NDArray[np.float64]) -> None:
        shrunk = LedoitWolf(store_precision=False).fit(X)
        raised = np.maximum(0.0, 1.0 - np.diag(shrunk.covariance_))
        self.location_ = shrunk.location_
        inverse = np.linalg.inv(shrunk.covariance_ + np.diag(raised)).astype(np.float32)
        # Exactly symmetric and in single precision, because a reference card stores one half.
        self.precision_ = ((inverse + inverse.T) / 2).astype(np.float64)

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        deviation = X - self.location_
        squared = np.einsum("ij,ij->i", deviation @ self.precision_, deviation)
        return np.asarray(np.sqrt(squared), dtype=np.float64)


class NearestRuns(OwnDetector):
    """Mean Euclidean distance to the nearest normal runs.

    Parameters
    ----------
    n_neighbors : int
    """

    def __init__(self, n_neighbors: int = 5) -> None:
        self.n_neighbors = n_neighbors

    def _learn(self, X: NDArray[np.float64]) -> None:
        if len(X) < self.n_neighbors:
            raise DetectorError(
                f"{len(X)} runs are too few for {self.n_neighbors} neighbours; "
                "fit on more runs or lower n_neighbors."
            )
        self.neighbors_ = NearestNeighbors(n_neighbors=self.n_neighbors).fit(X)

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        distances, _ = self.neighbors_.kneighbors(X)
        return np.asarray(distances.mean(axis=1), dtype=np.float64)
