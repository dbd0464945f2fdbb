"""Detectors based on clusters of normal runs.

Heights and sizes in a tree depend on all of its rows, so each row is scored in a separate tree of
the normal runs and that row.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.cluster import HDBSCAN
from sklearn.neighbors import NearestNeighbors

from oracle_pipeline.clustering.scores import hac_height, small_cluster_score
from oracle_pipeline.clustering.tree import Linkage, Tree, grow_tree, trees_with
from oracle_pipeline.detectors.base import DetectorError, OwnDetector

LARGE = 0.1  # smallest share of the normal runs in a large cluster


class _InTree(OwnDetector):
    """Stores the normal runs, and grows a tree of them and one row for each row."""

    linkage: Linkage

    def _learn(self, X: NDArray[np.float64]) -> None:
        self.reference_ = X

    def _in_trees(
        self, X: NDArray[np.float64], of_last: Callable[[Tree], float]
    ) -> NDArray[np.float64]:
        trees = trees_with(self.reference_, X, self.linkage)
        return np.fromiter((of_last(tree) for tree in trees), dtype=np.float64, count=len(X))


class HacHeight(_InTree):
    """The height at which a run joins half of the normal ones (`clustering.scores.hac_height`).

    Parameters
    ----------
    linkage : {"ward", "single", "complete", "average"}
        Average linkage performs best (docs/explanation/clustering.md).
    """

    def __init__(self, linkage: Linkage = "average") -> None:
        self.linkage = linkage

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        is_reference = np.arange(len(self.reference_) + 1) < len(self.reference_)
        return self._in_trees(X, lambda tree: float(hac_height(tree, is_reference)[-1]))


class SmallCluster(_InTree):
    """Size of the cluster of a run [1]_; smaller is more unusual.

    The rule is transductive: it depends on all clustered runs. Here these are the normal runs and
    the scored run.

    Parameters
    ----------
    kappa : float
        0.15 to 0.20 in the literature, which can be interpreted in two ways.
    reading : {"count", "size"}
        ``count``: the tree is cut into ``round(kappa n)`` clusters, and the score is the share of
        rows outside the run's cluster. ``size``: a cluster is small up to ``kappa n`` rows, and the
        score is the height at which the run's cluster exceeds that.
    linkage : {"ward", "single", "complete", "average"}

    References
    ----------
    .. [1] R. Almaghairbe, M. Roper, "Building test oracles by clustering failures", AST 2015.
    """

    def __init__(
        self,
        kappa: float = 0.175,
        reading: Literal["count", "size"] = "count",
        linkage: Linkage = "average",
    ) -> None:
        self.kappa = kappa
        self.reading = reading
        self.linkage = linkage

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.reading == "count":
            return self._in_trees(X, lambda tree: float(small_cluster_score(tree, self.kappa)[-1]))
        return self._in_trees(X, lambda tree: _height_of_growth(tree, self.kappa * len(tree)))


def _height_of_growth(tree: Tree, rows: float) -> float:
    """Return the height at which the cluster of the last row has more than `rows` rows."""
    own = len(tree) - 1
    reached = 0.0
    for merged, (left, right, height, size) in enumerate(tree.merges.tolist(), start=len(tree)):
        if own in (left, right):
            own, reached = merged, height
            if size > rows:
                break
    return float(reached)


class ReferenceDistance(OwnDetector):
    """Distance to the nearest large cluster of normal runs, in units of its spread.

    After LDCOF [1]_: the clusters are those of Ward's method, large clusters have at least a tenth
    of the runs, and the spread is the mean distance of their runs from the centroid, at least 1.

    Parameters
    ----------
    n_clusters : int
        Largest number of clusters of normal behaviour.

    References
    ----------
    .. [1] M. Amer, M. Goldstein, "Nearest-neighbor and clustering based anomaly detection
       algorithms for RapidMiner", RCOMM 2012.
    """

    def __init__(self, n_clusters: int = 3) -> None:
        self.n_clusters = n_clusters

    def _learn(self, X: NDArray[np.float64]) -> None:
        cluster = grow_tree(X, "ward").cut("maxclust", self.n_clusters)
        members = [cluster == name for name in np.unique(cluster)]
        large = [rows for rows in members if rows.mean() >= LARGE]
        self.centroids_ = np.array([X[rows].mean(axis=0) for rows in large])
        distance = cdist(X, self.centroids_)
        spread = [column[rows].mean() for column, rows in zip(distance.T, large, strict=True)]
        self.spread_ = np.maximum(spread, 1.0)  # rows are z-scores

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((cdist(X, self.centroids_) / self.spread_).min(axis=1), dtype=np.float64)


class DenseRegions(OwnDetector):
    """Distance to the nearest normal run that HDBSCAN assigns to a cluster.

    Parameters
    ----------
    min_cluster_size : int
        Smallest number of runs in a cluster.
    """

    def __init__(self, min_cluster_size: int = 5) -> None:
        self.min_cluster_size = min_cluster_size

    def _learn(self, X: NDArray[np.float64]) -> None:
        if len(X) < self.min_cluster_size:
            raise DetectorError(
                f"{len(X)} runs cannot form a cluster of {self.min_cluster_size}; "
                "fit on more runs or lower min_cluster_size."
            )
        clustering = HDBSCAN(
            min_cluster_size=self.min_cluster_size, allow_single_cluster=True, copy=True
        )
        clustered = clustering.fit(X).labels_ >= 0
        if not clustered.any():
            raise DetectorError(
                "HDBSCAN finds no cluster among these runs; use a detector without clusters."
            )
        self.neighbors_ = NearestNeighbors(n_neighbors=1).fit(X[clustered])

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        distances, _ = self.neighbors_.kneighbors(X)
        return np.asarray(distances[:, 0], dtype=np.float64)
