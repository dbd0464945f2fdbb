"""The dendrogram: grown from scaled rows, cut into flat clusters.

``oracle_pipeline.clustering.agglomeration`` computes the joins, and
``oracle_pipeline.clustering.scores`` verdicts and scores of runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster
from scipy.spatial.distance import cdist

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.clustering import agglomeration

Linkage = Literal["ward", "single", "complete", "average"]
Criterion = Literal["distance", "maxclust"]
LINKAGES: tuple[Linkage, ...] = ("ward", "single", "complete", "average")
CRITERIA: tuple[Criterion, ...] = ("distance", "maxclust")
MATRIX_ROWS = 15_000  # limit for a distance matrix, which then takes 1.8 GB


class ClusteringError(OracleError):
    """The rows cannot be clustered."""


@dataclass(frozen=True, eq=False, slots=True)
class Tree:
    """A dendrogram over n distinct rows."""

    method: Linkage
    merges: NDArray[np.float64]  # (n - 1, 4), SciPy's linkage matrix: two children, height, leaves
    copies: NDArray[np.int64]  # (n,), number of rows of each leaf

    def __len__(self) -> int:
        return len(self.copies)

    def cut(self, criterion: Criterion, t: float) -> NDArray[np.int32]:
        """Return the cluster of each distinct row, numbered from 1.

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


def grow_tree(
    X: NDArray[np.float64],
    method: Linkage = "ward",
    copies: NDArray[np.int64] | None = None,
) -> Tree:
    """Agglomerate rows by their Euclidean distance, exactly.

    The tree equals that of the rows repeated `copies` times, at the cost of the distinct rows. Ward
    and single linkage need linear memory, so 100,000 rows take minutes. Complete and average
    linkage need a distance matrix, so they are limited to `MATRIX_ROWS` rows.

    Parameters
    ----------
    X : ndarray of shape (n, n_features)
        Scaled and finite.
    method : {"ward", "single", "complete", "average"}
    copies : ndarray of shape (n,), optional
        Number of copies of each row, at least 1; by default 1.

    Raises
    ------
    ClusteringError
        Fewer than two rows, no column, or too many rows for a distance matrix.
    """
    n, columns = X.shape
    if n < 2 or columns < 1:
        raise ClusteringError(
            f"Cannot cluster {n} rows of {columns} features; "
            "at least two runs and one feature with a finite value are needed."
        )
    if n > MATRIX_ROWS and method in ("complete", "average"):
        raise ClusteringError(
            f"{method.capitalize()} linkage of {n} rows needs a matrix of {8e-9 * n * n:.0f} GB; "
            f"use ward or single linkage, or at most {MATRIX_ROWS} distinct rows."
        )
    copies = np.ones(n, dtype=np.int64) if copies is None else copies
    match method:
        case "ward":
            joins = agglomeration.ward(X, copies)
        case "single":
            joins = agglomeration.single(X)
        case "complete":
            joins = agglomeration.complete(agglomeration.distances_of(X))
        case "average":
            joins = agglomeration.average(agglomeration.distances_of(X), copies)
    return Tree(method, _merges(joins), copies)


def trees_with(
    reference: NDArray[np.float64], X: NDArray[np.float64], method: Linkage
) -> Iterator[Tree]:
    """Yield the tree of the reference rows and one more row, for each row of `X`.

    As `grow_tree`, including errors; the distances of the reference rows are computed once.
    """
    n = len(reference)
    if method in ("ward", "single") or n >= MATRIX_ROWS or not reference.size:
        yield from (grow_tree(np.vstack([reference, x]), method) for x in X)
        return
    known = np.full((n + 1, n + 1), np.inf)
    known[:n, :n] = agglomeration.distances_of(reference)
    copies = np.ones(n + 1, dtype=np.int64)
    for to_reference in cdist(X, reference):
        distances = known.copy()
        distances[n, :n] = distances[:n, n] = to_reference
        joins = (
            agglomeration.complete(distances)
            if method == "complete"
            else agglomeration.average(distances, copies)
        )
        yield Tree(method, _merges(joins), copies)


def _merges(joins: agglomeration.Joins) -> NDArray[np.float64]:
    """Return SciPy's linkage matrix of the joins, the lowest first."""
    n = len(joins.height) + 1
    order = np.argsort(joins.height, kind="stable")
    within, leaves = list(range(2 * n - 1)), [1] * n  # by node

    def top(node: int) -> int:
        while within[node] != node:
            within[node] = node = within[within[node]]
        return node

    merges = np.empty((n - 1, 4))
    for merged, (a, b) in enumerate(joins.rows[order].tolist(), start=n):
        left, right = sorted((top(a), top(b)))
        within[left] = within[right] = merged
        leaves.append(leaves[left] + leaves[right])
        merges[merged - n] = left, right, 0.0, leaves[merged]
    merges[:, 2] = joins.height[order]
    return merges
