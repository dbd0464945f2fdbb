import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist

from oracle_pipeline.clustering.tree import (
    CRITERIA,
    LINKAGES,
    ClusteringError,
    grid_search,
    grow_tree,
)


def copied_rows(seed):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(size=(9, 3)), rng.integers(1, 6, size=9), axis=0)


@pytest.mark.parametrize("method", LINKAGES)
@pytest.mark.parametrize("criterion", CRITERIA)
def test_clusters_are_those_of_scipy_and_copies_of_a_run_stay_together(method, criterion):
    for seed in range(5):
        X = copied_rows(seed)
        for t in (1.0, 2.0, 4.0):
            clusters = grow_tree(X, method).cut(criterion, t)
            expected = fcluster(linkage(pdist(X), method=method), t=t, criterion=criterion)
            assert clusters.tolist() == expected.tolist()
            assert len(np.unique(np.c_[X, clusters], axis=0)) == 9


def test_the_grid_holds_every_setting_once():
    points = list(grid_search(copied_rows(0), thresholds=(2.0, 3.0, 4.0)))
    settings = [(point.tree.method, point.criterion, point.t) for point in points]
    assert len(settings) == len(set(settings)) == 4 * 2 * 3
    assert all(len(np.unique(p.clusters)) <= p.t for p in points if p.criterion == "maxclust")


@pytest.mark.parametrize("shape", [(1, 3), (0, 3), (5, 0)])
def test_what_cannot_be_clustered_is_refused(shape):
    with pytest.raises(ClusteringError, match=f"{shape[0]} rows of {shape[1]} features"):
        grow_tree(np.zeros(shape))
