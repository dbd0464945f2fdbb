import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.clustering.tree import LINKAGES, MOST_ROWS, ClusteringError, grow_tree

methods = st.sampled_from(LINKAGES)


@st.composite
def tied_rows(draw):
    """Draw rows on a coarse grid: equal distances abound, and equal rows too."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    return rng.integers(0, 3, size=(draw(st.integers(2, 20)), 2)).astype(float)


@given(tied_rows(), methods, st.integers(1, 40))
def test_there_are_at_most_as_many_clusters_as_requested(rows, method, t):
    assert len(np.unique(grow_tree(rows, method).cut("maxclust", t))) <= t


@given(tied_rows(), methods, st.integers(0, 40))
def test_equal_rows_are_never_separated(rows, method, more):
    distinct = len(np.unique(rows, axis=0))
    tree = grow_tree(rows, method)
    for clusters in (tree.cut("maxclust", distinct + more), tree.cut("distance", 0.0)):
        assert len(np.unique(np.c_[rows, clusters], axis=0)) == distinct
        assert len(set(clusters.tolist())) == distinct


@pytest.mark.parametrize("shape", [(1, 3), (0, 3), (5, 0)])
def test_rows_that_cannot_be_clustered_are_an_error(shape):
    with pytest.raises(ClusteringError, match=f"{shape[0]} rows of {shape[1]} features"):
        grow_tree(np.zeros(shape))


def test_distances_that_do_not_fit_are_an_error_before_allocation():
    with pytest.raises(ClusteringError, match=f"15001 rows take 1 GB; use at most {MOST_ROWS}"):
        grow_tree(np.zeros((MOST_ROWS + 1, 1)))
