"""The dendrogram: grown from scaled rows, cut into flat clusters, searched over its settings.

Agglomeration itself is ``scipy.cluster.hierarchy``. What a cut says of a run is in
``oracle_pipeline.clustering.scores``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist

from oracle_pipeline.bags.errors import OracleError

Linkage = Literal["ward", "single", "complete", "average"]
Criterion = Literal["distance", "maxclust"]
LINKAGES: tuple[Linkage, ...] = ("ward", "single", "complete", "average")
CRITERIA: tuple[Criterion, ...] = ("distance", "maxclust")


class ClusteringError(OracleError):
    """The rows cannot be clustered."""


@dataclass(frozen=True, eq=False, slots=True)
class Tree:
    """A dendrogram over n rows."""

    method: Linkage
    merges: NDArray[np.float64]  # (n - 1, 4), SciPy's linkage matrix: two children, height, leaves

    def __len__(self) -> int:
        return len(self.merges) + 1

    def cut(self, criterion: Criterion, t: float) -> NDArray[np.int32]:
        """Return the cluster of each row, numbered from 1.

        Parameters
        ----------
        criterion : {"distance", "maxclust"}
            What `t` is: the greatest height within a cluster, or the greatest number of clusters.
        t : float
        """
        return fcluster(self.merges, t=t, criterion=criterion).astype(np.int32)


def grow_tree(X: NDArray[np.float64], method: Linkage = "ward") -> Tree:
    """Agglomerate rows by their Euclidean distance.

    Parameters
    ----------
    X : ndarray of shape (n, n_features)
        Scaled and finite.
    method : {"ward", "single", "complete", "average"}

    Raises
    ------
    ClusteringError
        Fewer than two rows, or no column.
    """
    rows, columns = X.shape
    if rows < 2 or columns < 1:
        raise ClusteringError(
            f"Cannot cluster {rows} rows of {columns} features; "
            "at least two runs and one feature with a finite value are needed."
        )
    return Tree(method, linkage(pdist(X), method=method))


class GridPoint(NamedTuple):
    """One setting of the grid and the clusters it gives."""

    tree: Tree
    criterion: Criterion
    t: float
    clusters: NDArray[np.int32]  # (n,)


def grid_search(
    X: NDArray[np.float64],
    methods: Sequence[Linkage] = LINKAGES,
    criteria: Sequence[Criterion] = CRITERIA,
    thresholds: Sequence[float] = (2.0, 4.0),
) -> Iterator[GridPoint]:
    """Cluster the rows with every linkage, criterion and threshold, the last varying fastest."""
    for method in methods:
        tree = grow_tree(X, method)
        for criterion in criteria:
            for t in thresholds:
                yield GridPoint(tree, criterion, t, tree.cut(criterion, t))
