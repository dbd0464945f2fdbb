"""Unsupervised verdicts from flat clusters, and scores from a tree.

Higher scores are more anomalous. ``oracle_pipeline.evaluation`` measures how good they are.
"""

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.clustering.tree import Tree


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
