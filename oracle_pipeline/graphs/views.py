"""Views of a graph: raw, the system without its observers, and the thesis's.

Observers are the recorder, command line tools and launch processes: their presence shows how the
system was observed, not how it behaves. Names generated at start-up have no meaning, so they are
replaced by numbers.
"""

import re
from collections.abc import Set

from oracle_pipeline.bags.graph_files import RosGraph, vertex_id

_OBSERVERS = re.compile(r"/(rosbag2_recorder|rosbag2_player|_ros2cli_\w+|launch_ros_\d+)")
_GENERATED_SUFFIX = re.compile(r"(/transform_listener_impl)_[0-9a-f]+")


def system_view(graph: RosGraph) -> RosGraph:
    """Return the graph without observers and without topics and services that only they use.

    ``/transform_listener_impl_<address>`` become ``/transform_listener_impl_0``, ``_1``, ..., in
    the order of their neighbours, so that equal systems have equal views.
    """
    gone = {
        vertex
        for vertex, data in graph.nodes(data=True)
        if data["kind"] == "node" and _OBSERVERS.fullmatch(data["label"])
    }
    gone |= {
        vertex
        for vertex, data in graph.nodes(data=True)
        if data["kind"] != "node"
        and (users := graph.pred[vertex].keys() | graph.succ[vertex].keys())
        and users <= gone
    }
    labels = _numbered(graph, gone)
    names = {
        vertex: vertex_id(graph.nodes[vertex]["kind"], labels[vertex])
        if vertex in labels
        else vertex
        for vertex in graph
        if vertex not in gone
    }
    view: RosGraph = graph.__class__(**graph.graph)
    for vertex, name in names.items():
        data = graph.nodes[vertex]
        view.add_node(name, **data | {"label": labels.get(vertex, data["label"])})
    view.add_edges_from(
        (names[source], names[target], traffic)
        for source, target, traffic in graph.edges(data=True)
        if source in names and target in names
    )
    return view


def thesis_view(graph: RosGraph) -> RosGraph:
    """Return the graph as the thesis's plugins expect it: plain names, ROS nodes and topics only.

    A ROS node and a topic of the same name become one vertex, as in the thesis.
    """
    import networkx as nx

    kept = [v for v, data in graph.nodes(data=True) if data["kind"] in ("node", "topic")]
    view: RosGraph = nx.relabel_nodes(
        graph.subgraph(kept), {vertex: graph.nodes[vertex]["label"] for vertex in kept}
    )
    return view


def _numbered(graph: RosGraph, gone: Set[str]) -> dict[str, str]:
    """Return labels with numbers, for the vertices that have generated ones and are not gone."""

    def neighbours(vertex: str) -> tuple[list[str], list[str], str]:
        before, after = graph.pred[vertex].keys() - gone, graph.succ[vertex].keys() - gone
        return sorted(before), sorted(after), vertex

    count: dict[str, int] = {}
    labels: dict[str, str] = {}
    generated = [
        v for v in graph if v not in gone and _GENERATED_SUFFIX.fullmatch(graph.nodes[v]["label"])
    ]
    for vertex in sorted(generated, key=neighbours):
        stem = _GENERATED_SUFFIX.sub(r"\1", graph.nodes[vertex]["label"])
        labels[vertex] = f"{stem}_{count.get(stem, 0)}"
        count[stem] = count.get(stem, 0) + 1
    return labels
