import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline import features
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.features.traffic import structural
from oracle_pipeline.features.traffic.structural import FEATURES, graph_shape
from oracle_pipeline.opened_run import open_run


def vector_graph() -> nx.DiGraph:
    """The test graph of the thesis analysis: A->t1, A->t2, t1->B, t2->B, B->t3."""
    graph = nx.DiGraph([("A", "t1"), ("A", "t2"), ("t1", "B"), ("t2", "B"), ("B", "t3")])
    nx.set_node_attributes(graph, {v: "node" if v in "AB" else "topic" for v in graph}, "kind")
    return graph


def test_corrected_features_of_the_test_vector():
    shape = graph_shape(vector_graph())
    assert shape["max_degree"] == 3
    assert shape["average_degree"] == 2.0
    assert shape["density"] == 0.25
    assert shape["bipartite_density"] == pytest.approx(0.4167, abs=1e-4)
    assert shape["degree_entropy"] == pytest.approx(0.9503, abs=1e-4)
    assert shape["max_in_degree_centrality"] == 0.5
    assert shape["degree_variance"] == pytest.approx(0.4)
    assert (shape["max_in_degree"], shape["max_out_degree"]) == (2, 2)
    assert shape["degree_cv"] == pytest.approx(np.sqrt(0.4) / 2)
    # The thesis's entropy of the same graph is 1.5571; ours is over that of an even draw.
    assert shape["node_entropy"] == pytest.approx(1.5571 / np.log(5), abs=1e-4)
    # Shortest paths: A-t1-B-t3 and A-t2-B-t3 tie; t1 and t2 also start paths of their own.
    assert shape["mean_betweenness"] == pytest.approx((1.0 + 1.0 + 3.0) / (4 * 3) / 5)


def test_features_are_those_declared():
    assert list(graph_shape(vector_graph())) == [feature.name for feature in FEATURES]


@st.composite
def bipartite_graphs(draw):
    nodes, topics = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    graph = nx.DiGraph()
    graph.add_nodes_from((("node", i) for i in range(nodes)), kind="node")
    graph.add_nodes_from((("topic", i) for i in range(topics)), kind="topic")
    pairs = [(("node", i), ("topic", j)) for i in range(nodes) for j in range(topics)]
    pairs += [(target, source) for source, target in pairs]
    graph.add_edges_from(draw(st.lists(st.sampled_from(pairs), min_size=1)))
    return graph


@given(bipartite_graphs())
def test_features_keep_their_bounds(graph):
    shape = graph_shape(graph)
    assert all(np.isfinite(list(shape.values())))
    assert 0 < shape["density"] <= shape["bipartite_density"] <= 1
    assert 0 <= shape["node_entropy"] <= 1 + 1e-12
    assert 0 <= shape["degree_entropy"] <= np.log(len(graph)) + 1e-12
    assert shape["average_degree"] <= shape["max_degree"]
    assert shape["max_degree"] <= shape["max_in_degree"] + shape["max_out_degree"]


@given(bipartite_graphs(), st.randoms())
def test_features_do_not_depend_on_names(graph, random):
    names = list(range(len(graph)))
    random.shuffle(names)
    renamed = nx.relabel_nodes(graph, dict(zip(graph, names, strict=True)))
    ours, theirs = graph_shape(graph), graph_shape(renamed)
    assert ours == pytest.approx(theirs)


def test_a_complete_graph_has_all_possible_edges():
    graph = nx.DiGraph([("n", "t"), ("t", "n")])
    nx.set_node_attributes(graph, {"n": "node", "t": "topic"}, "kind")
    shape = graph_shape(graph)
    assert shape["bipartite_density"] == 1.0
    assert shape["node_entropy"] == pytest.approx(1.0)
    assert shape["degree_entropy"] == 0.0


@given(bipartite_graphs())
def test_mean_betweenness_is_that_of_networkx(graph):
    expected = np.mean(list(nx.betweenness_centrality(graph).values()))
    assert graph_shape(graph)["mean_betweenness"] == pytest.approx(expected)


def test_the_raw_view_counts_observers_and_is_a_shortcut(make_run):
    with open_run(make_run().path) as run:
        table = features.extract(run, FeatureManager(tuple(structural.register_features()))).run
    row, fields = table.iloc[0], table.attrs["fields"]
    # The recorder is one more edge and vertex: of 5 and 7, see the windows in test_extraction.
    assert row["structural.average_degree"] == pytest.approx(10 / 7)
    assert row["structural_raw.average_degree"] == pytest.approx(12 / 8)
    assert {fields[c]["shortcut"] for c in fields if c.startswith("structural.")} == {"false"}
    assert {fields[c]["shortcut"] for c in fields if c.startswith("structural_raw.")} == {"true"}
