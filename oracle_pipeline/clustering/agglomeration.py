"""Agglomeration of weighted rows: which clusters join, and at what height.

The algorithms are those that Müllner recommends [1]_: the nearest-neighbour chain for Ward,
complete and average linkage, a minimum spanning tree for single linkage. All are exact. A row with
w copies starts as a cluster of size w, because copies have distance zero and join first. Ward needs
only the means of clusters, and single linkage only points, so their memory is linear in the number
of rows. The other two need the matrix of all distances.

``oracle_pipeline.clustering.tree`` builds the dendrogram from these joins.

References
----------
.. [1] D. Müllner, "Modern hierarchical, agglomerative clustering algorithms", arXiv:1109.2378.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from oracle_pipeline.bags.jit import jit

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]
Indices = NDArray[np.intp]

_WARD, _COMPLETE, _AVERAGE = range(3)
_BLOCK = 256  # points per block; their distances fit into the first-level cache
_NONE = -1


class Joins(NamedTuple):
    """The n - 1 joins of n rows, unordered; each has one row of either cluster."""

    rows: Indices  # (n - 1, 2)
    height: Floats  # (n - 1,)


def ward(X: Floats, copies: Counts) -> Joins:
    """Join rows by Ward's linkage, in linear memory and quadratic time."""
    order = _spatial_order(X)
    rows, squares = _chain(_features_first(X[order]), 0.5 / copies[order], _WARD)
    return Joins(order[rows], np.sqrt(squares))


def single(X: Floats) -> Joins:
    """Join rows by single linkage, in linear memory and quadratic time.

    The joins are the edges of the minimum spanning tree, by Prim's algorithm. The number of copies
    of a row does not matter.
    """
    order = _spatial_order(X)
    rows, squares = _prim(_features_first(X[order]))
    return Joins(order[rows], np.sqrt(squares))


def complete(distances: Floats) -> Joins:
    """Join rows by complete linkage; the number of copies of a row does not matter.

    The `distances` are overwritten.
    """
    return Joins(*_chain(distances, np.ones(len(distances)), _COMPLETE))


def average(distances: Floats, copies: Counts) -> Joins:
    """Join rows by average linkage (UPGMA); the `distances` are overwritten."""
    return Joins(*_chain(distances, 0.5 / copies, _AVERAGE))


def distances_of(X: Floats) -> Floats:
    """Return the distances (n, n) of all rows, infinite on the diagonal."""
    distances = cdist(X, X)
    np.fill_diagonal(distances, np.inf)
    return distances


def _spatial_order(X: Floats) -> Indices:
    """Return an order that keeps near rows together, so that searches can skip far blocks."""
    return np.asarray(KDTree(X, leafsize=_BLOCK).indices, dtype=np.intp)


def _features_first(X: Floats) -> Floats:
    """Return one row per feature, largest variance first, zero-padded to a multiple of four."""
    order = np.argsort(-X.var(axis=0), kind="stable")
    return np.ascontiguousarray(np.pad(X.T[order], ((0, -X.shape[1] % 4), (0, 0))))


@jit
def _chain(clusters: Floats, inverse: Floats, linkage: int) -> tuple[Indices, Floats]:
    """Join clusters in slots 0 to n - 1, by following nearest neighbours until two are mutual.

    Among equally near clusters the previous one in the chain wins, else the one in the first slot.

    Parameters
    ----------
    clusters : ndarray
        Ward's means, shape (n_features, n), or the distances, shape (n, n). Overwritten.
    inverse : ndarray of shape (n,)
        0.5 / size of each cluster. Overwritten.
    linkage : int

    Returns
    -------
    tuple of ndarray
        A row of either cluster, shape (n - 1, 2), and heights (squared for Ward's linkage).
    """
    n = len(inverse)
    rows, heights = np.empty((n - 1, 2), np.intp), np.empty(n - 1)
    row = np.arange(n)  # one row of the cluster in each slot
    chain = [0]
    for last in range(n - 1, 0, -1):  # slots up to `last` hold a cluster
        if not chain:
            chain.append(0)
        while True:
            slot, rival = chain[-1], chain[-2] if len(chain) > 1 else _NONE
            if linkage == _WARD:
                nearest, height = _nearest_mean(clusters, inverse[: last + 1], slot, rival)
            else:
                nearest, height = _nearest_in_row(clusters[slot, : last + 1], rival)
            if nearest == rival:
                break
            chain.append(nearest)
        kept, gone = min(slot, rival), max(slot, rival)
        rows[n - 1 - last], heights[n - 1 - last] = (row[kept], row[gone]), height
        share = inverse[kept] / (inverse[kept] + inverse[gone])  # weight of the removed cluster
        if linkage == _WARD:
            _join_means(clusters, share, kept, gone, last)
        else:
            _join_rows(clusters, share, kept, gone, last, linkage)
        inverse[kept] *= 1.0 - share
        inverse[gone], row[gone] = inverse[last], row[last]
        # Rounding may have led the chain back to one of the two, so drop everything after it.
        for _ in range(len(chain) - min(chain.index(kept), chain.index(gone))):
            chain.pop()
        for link in range(len(chain)):
            if chain[link] == last:
                chain[link] = gone
    return rows, heights


@jit
def _nearest_in_row(distances: Floats, rival: int) -> tuple[int, float]:
    """Return the slot of the nearest neighbour and its distance, from a row of the matrix."""
    nearest, lowest = rival, distances[rival] if rival != _NONE else np.inf
    for slot in range(len(distances)):
        if distances[slot] < lowest:
            nearest, lowest = slot, distances[slot]
    return nearest, lowest


@jit
def _join_rows(
    distances: Floats, share: float, kept: int, gone: int, last: int, linkage: int
) -> None:
    """Store the joined cluster in slot `kept`, and move that of slot `last` to slot `gone`."""
    for slot in range(last + 1):
        a, b = distances[kept, slot], distances[gone, slot]
        joined = (1.0 - share) * a + share * b if linkage == _AVERAGE else max(a, b)
        distances[kept, slot] = distances[slot, kept] = joined
    for slot in range(last + 1):
        distances[gone, slot] = distances[slot, gone] = distances[last, slot]
    distances[gone, gone] = np.inf


@jit
def _join_means(means: Floats, share: float, kept: int, gone: int, last: int) -> None:
    """Store the joined cluster in slot `kept`, and move that of slot `last` to slot `gone`."""
    for mean in means:
        # In this form equal means stay exactly equal, so copies stay at distance zero.
        mean[kept] += share * (mean[gone] - mean[kept])
        mean[gone] = mean[last]


@jit
def _nearest_mean(means: Floats, inverse: Floats, slot: int, rival: int) -> tuple[int, float]:
    """Return the slot of Ward's nearest neighbour and the squared height of that join.

    Means a and b of v and w rows join at the squared height ``2 |a - b|**2 / (1 / v + 1 / w)``,
    which equals the update formula of Lance and Williams, but needs no matrix.
    """
    nearest, lowest = _NONE, np.inf
    x, own = means[:, slot].copy(), inverse[slot]
    reach, squares = np.full(_BLOCK, np.inf), np.empty(_BLOCK)
    if rival != _NONE:
        _squares_within(means, x, rival, reach[:1], squares[:1])
        nearest, lowest = rival, squares[0] / (own + inverse[rival])
    for start in range(0, len(inverse), _BLOCK):
        size = min(_BLOCK, len(inverse) - start)
        for i in range(size):
            reach[i] = lowest * (own + inverse[start + i])
        if not _squares_within(means, x, start, reach[:size], squares[:size]):
            continue
        for i in range(size):
            if squares[i] < reach[i] and start + i != slot:
                square = squares[i] / (own + inverse[start + i])
                if square < lowest:
                    nearest, lowest = start + i, square
    return nearest, lowest


@jit
def _squares_within(points: Floats, x: Floats, start: int, reach: Floats, squares: Floats) -> bool:
    """Fill `squares` with the squared distances from `x` to the block of points at `start`.

    Returns False, unfinished, as soon as no point of the block is within its `reach`.
    """
    size = len(squares)
    squares[:] = 0.0
    for feature in range(0, len(x), 4):
        x0, x1, x2, x3 = x[feature], x[feature + 1], x[feature + 2], x[feature + 3]
        p0 = points[feature, start : start + size]
        p1 = points[feature + 1, start : start + size]
        p2 = points[feature + 2, start : start + size]
        p3 = points[feature + 3, start : start + size]
        for i in range(size):
            d0, d1, d2, d3 = p0[i] - x0, p1[i] - x1, p2[i] - x2, p3[i] - x3
            squares[i] += (d0 * d0 + d1 * d1) + (d2 * d2 + d3 * d3)
        within = 0
        for i in range(size):
            within += squares[i] < reach[i]
        if not within:
            return False
    return True


@jit
def _prim(points: Floats) -> tuple[Indices, Floats]:
    """Return the edges (n - 1, 2) of the minimum spanning tree and their squared lengths."""
    n = points.shape[1]
    rows, lengths = np.empty((n - 1, 2), np.intp), np.empty(n - 1)
    outside, neighbour = np.arange(n), np.zeros(n, np.intp)
    reach, squares = np.full(n, np.inf), np.empty(_BLOCK)
    added = 0  # slot of the row that joins the tree; slots up to `last` stay outside
    for last in range(n - 1, 0, -1):
        row, x = outside[added], points[:, added].copy()
        points[:, added] = points[:, last]
        outside[added], neighbour[added] = outside[last], neighbour[last]
        reach[added] = reach[last]
        added = 0
        for start in range(0, last, _BLOCK):
            stop = min(start + _BLOCK, last)
            if _squares_within(points, x, start, reach[start:stop], squares[: stop - start]):
                for i in range(start, stop):
                    if squares[i - start] < reach[i]:
                        reach[i], neighbour[i] = squares[i - start], row
            for i in range(start, stop):
                if reach[i] < reach[added]:
                    added = i
        rows[n - 1 - last] = neighbour[added], outside[added]
        lengths[n - 1 - last] = reach[added]
    return rows, lengths
