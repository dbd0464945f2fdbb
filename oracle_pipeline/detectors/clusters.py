"""The detector that is based on a dendrogram of normal runs."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist

from oracle_pipeline.clustering.scores import hac_height
from oracle_pipeline.clustering.tree import Linkage, tree_of
from oracle_pipeline.detectors.base import OwnDetector


class HacHeight(OwnDetector):
    """The height at which a run joins half of the normal ones (`clustering.scores.hac_height`).

    Heights in a tree depend on all of its rows, so each row is scored in a separate tree of the
    normal runs and that row.

    Parameters
    ----------
    linkage : {"ward", "single", "complete", "average"}
        Average linkage performs best (docs/explanation/clustering.md).
    """

    def __init__(self, linkage: Linkage = "average") -> None:
        self.linkage = linkage

    def _learn(self, X: NDArray[np.float64]) -> None:
        self.reference_ = X

    def _distance(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        among_reference = pdist(self.reference_)
        is_reference = np.arange(len(self.reference_) + 1) > 0  # the scored row comes first
        trees = (
            tree_of(np.append(to_reference, among_reference), self.linkage)
            for to_reference in cdist(X, self.reference_)
        )
        return np.array([hac_height(tree, is_reference)[0] for tree in trees], dtype=np.float64)
