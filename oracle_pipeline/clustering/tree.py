"""The dendrogram: grown from scaled rows by SciPy, cut into flat clusters.

Flat clusters give verdicts on rows, and heights in the tree scores of them.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist

from oracle_pipeline.bags.errors import OracleError

Linkage = Literal["ward", "single", "complete", "average"]
Criterion = Literal["distance", "maxclust"]
LINKAGES: tuple[Linkage, ...] = ("ward", "single", "complete", "average")
CRITERIA: tuple[Criterion, ...] = ("distance", "maxclust")
MOST_ROWS = 15_000  # whose distances take 0.9 GB


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

        Rows at distance zero are never separated. With ``maxclust``, if `t` is at least the number
        of distinct rows, each distinct row is a cluster.

        Parameters
        ----------
        criterion : {"distance", "maxclust"}
            Meaning of `t`: the greatest height within a cluster, or the greatest number of
            clusters.
        t : float
        """
        if criterion == "maxclust":
            most = min(max(int(t), 1), len(self))
            t = np.append(0.0, self.merges[:, 2])[len(self) - most]
        return fcluster(self.merges, t=t, criterion="distance").astype(np.int32)


def grow_tree(X: NDArray[np.float64], method: Linkage = "ward") -> Tree:
    """Agglomerate rows by their Euclidean distance; copies of a row have distance zero.

    Parameters
    ----------
    X : ndarray of shape (n, n_features)
        Scaled and finite.
    method : {"ward", "single", "complete", "average"}

    Raises
    ------
    ClusteringError
        Fewer than two rows, no column, or more than `MOST_ROWS` rows.
    """
    n, columns = X.shape
    if n < 2 or columns < 1:
        raise ClusteringError(
            f"Cannot cluster {n} rows of {columns} features; "
            "at least two runs and one feature with a finite value are needed."
        )
    if n > MOST_ROWS:
        raise ClusteringError(
            f"The distances of {n} rows take {4e-9 * n * n:.0f} GB; use at most {MOST_ROWS} rows."
        )
    return Tree(method, linkage(pdist(X), method))


def hac_height(tree: Tree) -> NDArray[np.float64]:
    """Return the height at which each row joins the majority.

    ``h(x) = min {t : the component of x at height t has at least half of the rows}``. This makes a
    dendrogram comparable with any detector: if most rows are normal, an unusual one joins late.
    With single linkage it is the minimax path distance to the majority.

    Parameters
    ----------
    tree : Tree
        Over n rows.

    Returns
    -------
    ndarray of shape (n,)
        Heights, in the tree's unit of distance.
    """
    n = len(tree)
    children = tree.merges[:, :2].astype(np.intp).tolist()
    held = [1] * n + [0] * (n - 1)
    for node, (left, right) in enumerate(children, start=n):
        held[node] = held[left] + held[right]

    half = n / 2
    height = [0.0] * n + tree.merges[:, 2].tolist()
    for node in range(2 * n - 2, n - 1, -1):  # from the root down
        for child in children[node - n]:
            if held[child] < half:
                height[child] = height[node]
    return np.array(height[:n])


def outside_largest(clusters: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Call every row outside the largest cluster anomalous.

    The rule assumes that normal behaviour is the most common [1]_. The first of equally large
    clusters counts as the largest.

    References
    ----------
    .. [1] R. Almaghairbe, M. Roper, "Building test oracles by clustering failures", AST 2015.

    Examples
    --------
    >>> outside_largest(np.array([2, 1, 2, 3], dtype=np.int32))
    array([False,  True, False,  True])
    """
    largest = np.argmax(np.bincount(clusters))
    return np.asarray(clusters != largest, dtype=np.bool_)
