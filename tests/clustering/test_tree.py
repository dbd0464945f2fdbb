import numpy as np
import pytest

from oracle_pipeline.clustering.tree import (
    ClusteringError,
    grid_search,
    grow_tree,
)


def copied_rows(seed):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(size=(9, 3)), rng.integers(1, 6, size=9), axis=0)


def test_the_grid_holds_every_setting_once():
    points = list(grid_search(copied_rows(0), thresholds=(2.0, 3.0, 4.0)))
    settings = [(point.tree.method, point.criterion, point.t) for point in points]
    assert len(settings) == len(set(settings)) == 4 * 2 * 3
    assert all(len(np.unique(p.clusters)) <= p.t for p in points if p.criterion == "maxclust")


def test_the_grid_counts_copies():
    X, copies = np.arange(4.0)[:, None] ** 2, np.array([1, 5, 2, 1])
    assert all(p.tree.copies is copies for p in grid_search(X, copies=copies))


@pytest.mark.parametrize("shape", [(1, 3), (0, 3), (5, 0)])
def test_what_cannot_be_clustered_is_refused(shape):
    with pytest.raises(ClusteringError, match=f"{shape[0]} rows of {shape[1]} features"):
        grow_tree(np.zeros(shape))
