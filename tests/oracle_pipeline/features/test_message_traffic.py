import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.features import Located, Missing, Window
from oracle_pipeline.features.traffic.message_traffic import FEATURES, closeness, compute, prepare
from oracle_pipeline.graphs.intervals import Interval, compose
from oracle_pipeline.graphs.views import system_view


def graph_of(*edges: tuple[str, str, int]) -> nx.DiGraph:
    """Edges such as ("n:/a", "t:/x", 10), n for a ROS node, t for a topic; bytes are tenfold."""
    kinds = {"n": "node", "t": "topic"}
    graph: nx.DiGraph = nx.DiGraph()
    for source, target, messages in edges:
        for vertex in (source, target):
            kind, _, name = vertex.partition(":")
            graph.add_node(vertex, kind=kinds[kind], label=name, type="")
        graph.add_edge(source, target, messages=messages, bytes=10 * messages)
    return graph


def window_of(*graphs: nx.DiGraph, start_s: float = 0.0) -> Window:
    intervals = tuple(Interval(10.0 * i, graph) for i, graph in enumerate(graphs))
    whole = compose(interval.graph for interval in intervals if interval.start_s >= start_s)
    end_s = 10.0 * len(graphs)
    return Window(start_s, end_s, whole, system_view(whole), intervals, {})


def values_of(*graphs: nx.DiGraph, start_s: float = 0.0):
    window = window_of(*graphs, start_s=start_s)
    prepared = prepare(window)
    return compute(
        Window(window.start_s, window.end_s, window.graph, window.system, window.intervals, {},
               prepared=prepared)
    )  # fmt: skip


RELAY = (("n:/a", "t:/x", 30), ("t:/x", "n:/b", 30), ("n:/b", "t:/y", 10), ("t:/y", "n:/c", 10))


def test_flows_of_a_relay():
    values = values_of(graph_of(*RELAY))
    shares = np.array([3, 3, 1, 1]) / 8
    assert values["flow_entropy"] == pytest.approx(-np.sum(shares * np.log(shares)))
    assert values["byte_flow_entropy"] == values["flow_entropy"]
    assert values["flow_variance"] == pytest.approx(100.0 / 400.0)
    assert values["largest_flow"] == Located(3 / 8, "t:/x -> n:/b")
    # /a gives 30, /b takes 20 more than it gives, /c takes 10, of 80.
    assert values["imbalance"] == pytest.approx(60 / 80)
    assert values["imbalance_max"] == Located(30 / 80, "n:/a")


def test_closeness_counts_an_edge_as_long_as_it_is_quiet():
    values = values_of(graph_of(("n:/a", "t:/x", 30), ("t:/x", "n:/b", 10)))
    # Mean 20: edges of 2/3 and 2. x is reached by one of two at 2/3, b by both, 14/3 in sum.
    assert values["closeness_max"] == Located(pytest.approx(1 / (2 / 3) / 2), "t:/x")
    assert values["closeness_mean"] == pytest.approx((0.75 + 2 / (14 / 3)) / 3)


def test_observers_do_not_count():
    watched = graph_of(*RELAY, ("t:/x", "n:/rosbag2_recorder", 30))
    assert values_of(watched) == values_of(graph_of(*RELAY))


def test_a_graph_is_compared_with_the_interval_before():
    before, after = graph_of(*RELAY), graph_of(*RELAY[:2], ("n:/b", "t:/z", 20))
    values = values_of(before, after, start_s=10.0)
    # Shares 3/8 3/8 1/8 1/8 0 become 3/8 3/8 0 0 1/4.
    assert values["flow_change"] == Located(pytest.approx(0.25), "n:/b -> t:/z")
    assert values["appeared_edges"] == 1.0
    assert values["vanished_edges"] == 2.0


def test_a_longer_interval_of_the_same_traffic_is_no_change():
    twice = graph_of(*((source, target, 2 * n) for source, target, n in RELAY))
    values = values_of(graph_of(*RELAY), twice)
    assert values["flow_change"].value == pytest.approx(0.0)
    assert values["appeared_edges"] == values["vanished_edges"] == 0.0


def test_the_first_interval_has_none_before():
    values = values_of(graph_of(*RELAY))
    assert isinstance(values["flow_change"], Missing)


def test_what_the_start_shifts_less_in_a_longer_run_depends_on_the_length():
    def after_a_start(intervals):
        steady = [(source, target, intervals * n) for source, target, n in RELAY]
        return values_of(graph_of(("n:/a", "t:/map", 50), ("t:/map", "n:/b", 50), *steady))

    short, long = after_a_start(3), after_a_start(30)
    shifted = {name for name, value in short.items() if value != long[name]}
    assert {"imbalance", "flow_entropy", "largest_flow"} <= shifted
    assert shifted <= {each.name for each in FEATURES if each.extensive}


def test_without_messages_there_is_no_flow():
    assert isinstance(values_of(graph_of(("n:/a", "t:/x", 0))), Missing)


@st.composite
def weighted_graphs(draw):
    """Lengths are powers of two, whose sums are exact, so equal paths are equal for both."""
    n = draw(st.integers(2, 7))
    pairs = [(i, j) for i in range(n) for j in range(n) if i != j]
    edges = draw(st.dictionaries(st.sampled_from(pairs), st.sampled_from([0.5, 1.0, 2.0])))
    graph = nx.DiGraph()
    graph.add_nodes_from(range(n))
    graph.add_edges_from((i, j, {"length": length}) for (i, j), length in edges.items())
    return graph


@given(weighted_graphs())
def test_closeness_is_that_of_networkx(graph):
    lengths = np.full((len(graph), len(graph)), np.inf)
    for source, target, length in graph.edges(data="length"):
        lengths[source, target] = length
    assert dict(enumerate(closeness(lengths))) == pytest.approx(
        nx.closeness_centrality(graph, distance="length")
    )
