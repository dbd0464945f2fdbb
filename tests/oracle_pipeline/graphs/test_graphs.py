import networkx as nx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import GraphError
from oracle_pipeline.bags.graph_files import vertex_id, write_gexf
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import Interval, compose, known_in, read_intervals
from oracle_pipeline.graphs.views import system_view, thesis_view

NODES = ("/amcl", "/rosbag2_recorder", "/transform_listener_impl_5581ab", "/bt_navigator")
TOPICS = ("/scan", "/tf", "/events/write_split")


def graph_of(*edges: tuple[str, str], counts: int = 1) -> nx.DiGraph:
    """Edges between names; a name in capitals is a ROS node, every other a topic."""
    graph = nx.DiGraph()
    for pair in edges:
        ends = [vertex_id("node" if name in NODES else "topic", name) for name in pair]
        for vertex, name in zip(ends, pair, strict=True):
            kind = vertex.partition(":")[0]
            graph.add_node(vertex, label=name, kind=kind, type="" if kind == "node" else "T")
        graph.add_edge(*ends, messages=counts, bytes=10 * counts)
    return graph


relations = st.sampled_from([(n, t) for n in NODES for t in TOPICS] + [("/scan", "/amcl")])
graphs = st.lists(relations, max_size=6).flatmap(
    lambda edges: st.builds(lambda counts: graph_of(*edges, counts=counts), st.integers(0, 100))
)


def content(graph: nx.DiGraph) -> tuple[dict, dict]:
    return dict(graph.nodes(data=True)), {edge: graph.edges[edge] for edge in graph.edges}


@given(graphs, graphs, graphs)
def test_composition_is_a_sum(a, b, c):
    assert content(compose([a, b])) == content(compose([b, a]))
    assert content(compose([compose([a, b]), c])) == content(compose([a, b, c]))
    assert content(compose([a])) == content(a)
    total = sum(traffic["messages"] for _, _, traffic in compose([a, b]).edges(data=True))
    assert total == sum(d["messages"] for graph in (a, b) for *_, d in graph.edges(data=True))


def test_composition_does_not_change_its_inputs():
    a, b = graph_of(("/amcl", "/tf")), graph_of(("/amcl", "/tf"))
    compose([a, b])
    assert a.edges["node:/amcl", "topic:/tf"]["messages"] == 1


def test_a_span_has_the_intervals_that_ended_in_it_or_else_the_newest_before():
    first, second = (Interval(start_s, nx.DiGraph()) for start_s in (0.0, 10.0))
    both, recorded_s = (first, second), 18.0
    assert known_in(both, 0.0, 10.0, recorded_s) == (first,)
    assert known_in(both, 5.0, 15.0, recorded_s) == (first,)
    assert known_in(both, 10.0, 15.0, recorded_s) == (first,)
    assert known_in(both, 13.0, 18.0, recorded_s) == (second,)
    assert known_in(both, 0.0, 18.0, recorded_s) == both
    assert known_in(both, 0.0, 5.0, recorded_s) == ()
    assert known_in((), 0.0, 10.0, 10.0) == ()


@given(st.floats(0.0, 60.0), st.floats(0.1, 20.0), st.floats(0.0, 20.0))
def test_graphs_do_not_depend_on_later_messages(start_s, length_s, more_s):
    intervals = tuple(Interval(10.0 * n, nx.DiGraph()) for n in range(10))
    end_s = start_s + length_s
    ended = tuple(each for each in intervals if each.start_s + 10.0 <= end_s)
    later = known_in(intervals, start_s, end_s, end_s + 10.0 + more_s)
    assert later == known_in(ended, start_s, end_s, end_s)


def test_intervals_are_read_in_order_of_time(tmp_path):
    for start in (10, 0, 100, 20, 30, 40, 50, 60, 70, 80, 90):
        write_gexf(graph_of(("/amcl", "/tf"), counts=start), tmp_path / f"{start:06d}.gexf")
    write_gexf(graph_of(), tmp_path / "run.gexf")
    intervals = read_intervals(tmp_path)
    assert [interval.start_s for interval in intervals] == [10.0 * n for n in range(11)]
    edge = intervals[10].graph.edges["node:/amcl", "topic:/tf"]
    assert edge == {"messages": 100, "bytes": 1000}


def test_a_missing_interval_is_an_error(tmp_path):
    with pytest.raises(GraphError, match="absent"):
        read_intervals(tmp_path / "absent")
    assert read_intervals(tmp_path) == ()
    for start in (0, 20):
        write_gexf(graph_of(), tmp_path / f"{start:06d}.gexf")
    with pytest.raises(GraphError, match=r"one graph every 10 s.*\[0, 20\]"):
        read_intervals(tmp_path)


def test_the_system_view_has_no_observers_and_no_topics_that_only_they_use():
    graph = graph_of(
        ("/amcl", "/tf"), ("/scan", "/amcl"),
        ("/tf", "/rosbag2_recorder"), ("/rosbag2_recorder", "/events/write_split"),
    )  # fmt: skip
    assert sorted(system_view(graph)) == ["node:/amcl", "topic:/scan", "topic:/tf"]
    assert len(graph) == 5


@pytest.mark.parametrize(
    "observer", ["/rosbag2_recorder", "/_ros2cli_1234", "/_ros2cli_daemon_0_ab12", "/launch_ros_99"]
)
def test_every_observer_is_recognised(observer):
    graph = graph_of(("/amcl", "/tf"))
    graph.add_node(f"node:{observer}", label=observer, kind="node", type="")
    assert content(system_view(graph)) == content(graph_of(("/amcl", "/tf")))


def test_an_unused_topic_is_kept():
    graph = graph_of(("/amcl", "/tf"))
    graph.add_node("topic:/goal_pose", label="/goal_pose", kind="topic", type="T")
    assert "topic:/goal_pose" in system_view(graph)


@given(st.permutations(["5581ab", "7f00", "0abc", "99"]), st.permutations(["1", "2a", "3", "f"]))
def test_generated_names_do_not_distinguish_equal_systems(one, other):
    def system(suffixes):
        graph = nx.DiGraph()
        for number, suffix in enumerate(suffixes):
            name, topic = f"/transform_listener_impl_{suffix}", f"topic:/tf{number % 2}"
            graph.add_node(f"node:{name}", label=name, kind="node", type="")
            graph.add_node(topic, label=topic[6:], kind="topic", type="T")
            graph.add_edge(topic, f"node:{name}", messages=0, bytes=0)
        return system_view(graph)

    assert content(system(one)) == content(system(other))
    assert "node:/transform_listener_impl_3" in system(one)
    assert content(system_view(system(one))) == content(system(one))


def test_the_thesis_view_has_plain_names():
    graph = graph_of(("/amcl", "/tf"))
    graph.add_node("service:/amcl/get_state", label="/amcl/get_state", kind="service", type="T")
    view = thesis_view(graph)
    assert set(view) == {"/amcl", "/tf"}
    assert list(view.edges) == [("/amcl", "/tf")]


def intervals_of(parts) -> tuple[Interval, ...]:
    return tuple(Interval(10.0 * number, graph) for number, graph in enumerate(parts))


@settings(max_examples=50)
@given(st.lists(graphs, max_size=3), st.lists(graphs, max_size=3))
def test_differences_are_symmetric_and_none_means_equal(a, b):
    forth = graph_differences(intervals_of(a), intervals_of(b))
    back = graph_differences(intervals_of(b), intervals_of(a))
    swap = {"a": "b", "b": "a"}
    assert {(d.start_s, d.element, d.only_in) for d in forth} == {
        (d.start_s, d.element, swap[d.only_in]) for d in back
    }
    same = all(x.nodes == y.nodes and x.edges == y.edges for x, y in zip(a, b, strict=False))
    assert (forth == []) == same


def test_traffic_does_not_count_as_a_difference_but_a_type_does():
    one, other = graph_of(("/amcl", "/tf")), graph_of(("/amcl", "/tf"), counts=7)
    assert graph_differences(intervals_of([one]), intervals_of([other])) == []
    other.nodes["topic:/tf"]["type"] = "U"
    differences = graph_differences(intervals_of([one]), intervals_of([other]))
    assert [str(d) for d in differences] == [
        "at 0 s only a has topic:/tf (T)",
        "at 0 s only b has topic:/tf (U)",
    ]


def test_only_intervals_that_both_have_are_compared():
    a, b = graph_of(("/amcl", "/tf")), graph_of(("/scan", "/amcl"))
    assert graph_differences(intervals_of([a, b]), intervals_of([a])) == []
