import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.clustering.tree import LINKAGES, Tree, grow_tree, hac_height, outside_largest


def slow_hac_height(tree):
    """Try every height from below: the definition, word by word."""
    heights = np.full(len(tree), np.nan)
    for t in [0.0, *tree.merges[:, 2]]:
        clusters = tree.cut("distance", t)
        for x in range(len(tree)):
            component = clusters == clusters[x]
            if np.isnan(heights[x]) and component.sum() >= len(tree) / 2:
                heights[x] = t
    return heights


@st.composite
def trees(draw):
    n = draw(st.integers(2, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    X = rng.normal(size=(n, 2))[rng.integers(0, n, size=n)]  # with copies
    return grow_tree(X, draw(st.sampled_from(LINKAGES)))


@given(trees())
def test_hac_height_is_the_lowest_height_that_holds_half_of_the_rows(tree):
    assert hac_height(tree).tolist() == slow_hac_height(tree).tolist()


def test_an_anomalous_run_joins_the_majority_last():
    X = np.r_[np.random.default_rng(0).normal(size=(40, 3)), [[30.0, 0.0, 0.0]]]
    for method in LINKAGES:
        assert hac_height(grow_tree(X, method)).argmax() == 40


def test_a_chain_of_ten_thousand_runs_needs_no_recursion():
    n = 10_000
    nodes = np.r_[0, n + np.arange(n - 2)]
    merges = np.c_[nodes, np.arange(1, n), np.arange(1.0, n), np.arange(2, n + 1)]
    height = hac_height(Tree("single", merges))
    assert height[0] == n / 2 - 1
    assert height[-1] == n - 1


@given(st.lists(st.integers(1, 4), min_size=1, max_size=20))
def test_rows_outside_the_largest_cluster_are_never_the_most_common(clusters):
    names = np.array(clusters, dtype=np.int32)
    inside = names[~outside_largest(names)]
    assert len(set(inside.tolist())) == 1
    assert len(inside) == max(clusters.count(name) for name in clusters)
