import numpy as np
import pytest

from oracle_pipeline.clustering.tree import LINKAGES, ClusteringError, grow_tree, trees_with


def copied_rows(seed):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(size=(9, 3)), rng.integers(1, 6, size=9), axis=0)


@pytest.mark.parametrize("method", LINKAGES)
@pytest.mark.parametrize("t", [2.0, 3.0, 4.0])
def test_there_are_at_most_as_many_clusters_as_requested(method, t):
    tree = grow_tree(copied_rows(0), method)
    assert tree.method == method
    assert len(np.unique(tree.cut("maxclust", t))) <= t


@pytest.mark.parametrize("method", LINKAGES)
def test_a_tree_counts_copies(method):
    X, copies = np.arange(4.0)[:, None] ** 2, np.array([1, 5, 2, 1])
    assert grow_tree(X, method, copies).copies is copies


@pytest.mark.parametrize("method", LINKAGES)
def test_a_tree_with_one_more_row_equals_the_tree_of_all_rows(method):
    rng = np.random.default_rng(1)
    reference, rows = rng.normal(size=(30, 4)), rng.normal(size=(5, 4))
    for row, tree in zip(rows, trees_with(reference, rows, method), strict=True):
        expected = grow_tree(np.vstack([reference, row]), method)
        np.testing.assert_array_equal(tree.merges, expected.merges)


@pytest.mark.parametrize("shape", [(1, 3), (0, 3), (5, 0)])
def test_rows_that_cannot_be_clustered_are_an_error(shape):
    with pytest.raises(ClusteringError, match=f"{shape[0]} rows of {shape[1]} features"):
        grow_tree(np.zeros(shape))
