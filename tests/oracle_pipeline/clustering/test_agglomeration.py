import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import cdist

from oracle_pipeline.clustering.scores import hac_height, outside_largest, small_cluster_score
from oracle_pipeline.clustering.tree import LINKAGES, MATRIX_ROWS, ClusteringError, grow_tree

methods = st.sampled_from(LINKAGES)
seeds = st.integers(0, 2**32)


@st.composite
def rows_and_copies(draw, most_copies=6):
    """Draw distinct rows, no two distances alike, and how often each stands in the data."""
    n = draw(st.integers(2, 20))
    rng = np.random.default_rng(draw(seeds))
    X = rng.normal(size=(n, draw(st.integers(1, 6))))
    return X, rng.integers(1, most_copies, size=n, endpoint=True)


@st.composite
def tied_rows(draw):
    """Draw rows on a coarse grid: equal distances abound, and equal rows too."""
    n = draw(st.integers(2, 9))
    rng = np.random.default_rng(draw(seeds))
    return rng.integers(0, 3, size=(n, 2)).astype(float), rng.integers(1, 4, size=n)


def same_partition(a, b):
    pairs = set(zip(a.tolist(), b.tolist(), strict=True))
    return len(pairs) == len(set(a.tolist())) == len(set(b.tolist()))


def between(method, a, b, X, copies):
    """Return the height at which two sets of rows join: the definition, word by word."""
    if method == "ward":
        v, w = copies[a].sum(), copies[b].sum()
        means = (np.average(X[rows], axis=0, weights=copies[rows]) for rows in (a, b))
        return np.sqrt(2 * v * w / (v + w)) * np.linalg.norm(np.subtract(*means))
    distances = cdist(np.repeat(X[a], copies[a], axis=0), np.repeat(X[b], copies[b], axis=0))
    return {"single": np.min, "complete": np.max, "average": np.mean}[method](distances)


@given(rows_and_copies(), methods, st.data())
def test_the_tree_of_counted_rows_is_that_of_scipy_over_repeated_rows(rows, method, data):
    X, copies = rows
    row = np.repeat(np.arange(len(X)), copies)
    tree, expected = grow_tree(X, method, copies), linkage(X[row], method)
    assert not expected[: len(row) - len(X), 2].any()  # copies join first
    assert np.allclose(tree.merges[:, 2], expected[len(row) - len(X) :, 2], rtol=1e-9)
    fewer_than_rows = data.draw(st.integers(1, len(row) - 1))
    between_heights = data.draw(st.sampled_from(tree.merges[:, 2])) * (1 + 1e-6)
    for criterion, t in (("maxclust", fewer_than_rows), ("distance", between_heights)):
        assert same_partition(tree.cut(criterion, t)[row], fcluster(expected, t, criterion))


@settings(max_examples=40)
@given(rows_and_copies(), methods, st.floats(0.05, 0.9))
def test_scores_of_counted_rows_are_those_of_repeated_rows(rows, method, kappa):
    X, copies = rows
    row = np.repeat(np.arange(len(X)), copies)
    tree, repeated = grow_tree(X, method, copies), grow_tree(X[row], method)
    assert np.allclose(hac_height(tree)[row], hac_height(repeated))
    assert np.allclose(small_cluster_score(tree, kappa)[row], small_cluster_score(repeated, kappa))
    sizes = np.unique(clusters := tree.cut("maxclust", 3)[row], return_counts=True)[1]
    inside = clusters[~outside_largest(tree.cut("maxclust", 3), copies)[row]]
    assert len(inside) == sizes.max()


@settings(max_examples=120)
@given(tied_rows(), methods)
def test_every_join_is_of_two_clusters_that_are_nearest_even_if_others_are_as_near(rows, method):
    X, copies = rows
    tree = grow_tree(X, method, copies)
    clusters = {row: [row] for row in range(len(X))}
    for node, (left, right, height, leaves) in enumerate(tree.merges, start=len(X)):
        heights = [
            between(method, a, b, X, copies)
            for i, a in clusters.items()
            for j, b in clusters.items()
            if i < j
        ]
        a, b = clusters.pop(int(left)), clusters.pop(int(right))
        assert height == pytest.approx(between(method, a, b, X, copies), abs=1e-9)
        assert height == pytest.approx(min(heights), abs=1e-9)
        assert leaves == len(a + b)
        clusters[node] = a + b


@given(tied_rows(), methods, st.integers(0, 40))
def test_equal_rows_are_never_separated(rows, method, more):
    X, copies = rows
    distinct = len(np.unique(X, axis=0))
    tree = grow_tree(X, method, copies)
    for clusters in (tree.cut("maxclust", distinct + more), tree.cut("distance", 0.0)):
        assert len(np.unique(np.c_[X, clusters], axis=0)) == len(set(clusters.tolist())) == distinct


@given(rows_and_copies(), methods)
def test_rows_count_once_by_default(rows, method):
    X, _ = rows
    assert np.allclose(grow_tree(X, method).merges, linkage(X, method), rtol=1e-9)


def test_a_lone_row_joins_a_cluster_of_copies_at_wards_height():
    # Sizes 3 and 1, four apart: sqrt(2 * 3 * 1 / 4) * 4.
    tree = grow_tree(np.array([[0.0], [4.0]]), "ward", np.array([3, 1]))
    assert tree.merges.tolist() == [[0, 1, pytest.approx(np.sqrt(1.5) * 4), 2]]


@pytest.mark.parametrize("method", LINKAGES)
@pytest.mark.parametrize("features", [1, 7])
def test_many_rows_give_the_tree_of_scipy(method, features):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(1500, features)) + 5.0 * rng.integers(0, 4, size=(1500, 1))
    tree, expected = grow_tree(X, method), linkage(X, method)
    assert np.allclose(tree.merges[:, 2], expected[:, 2], rtol=1e-9)
    for k in (2, 4, 40, 700):
        assert same_partition(tree.cut("maxclust", k), fcluster(expected, k, "maxclust"))


@pytest.mark.parametrize("method", ["ward", "single"])
def test_memory_is_linear_in_the_number_of_rows(method):
    X = np.random.default_rng(0).normal(size=(6000, 3))
    tracemalloc.start()
    grow_tree(X, method)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * len(X) ** 2 / 50


@pytest.mark.parametrize("method", ["complete", "average"])
def test_a_matrix_that_does_not_fit_is_an_error_before_allocation(method):
    with pytest.raises(ClusteringError, match="15001 rows needs a matrix of 2 GB; use ward or sin"):
        grow_tree(np.zeros((MATRIX_ROWS + 1, 1)), method)
