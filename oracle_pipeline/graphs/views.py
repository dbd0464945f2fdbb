"""Views of a graph: raw, the system without its observers, and the thesis's.

Observers are the recorder, command line tools and launch processes: their presence shows how the
system was observed, not how it behaves. Names generated at start-up have no meaning, so they are
replaced by numbers.
"""

import re

from oracle_pipeline.bags.graph_files import RosGraph, vertex_id

_OBSERVERS = re.compile(r"/(rosbag2_recorder|rosbag2_player|_ros2cli_\w+|launch_ros_\d+)")
_GENERATED_SUFFIX = re.compile(r"(/transform_listener_impl)_[0-9a-f]+")


def system_view(graph: RosGraph) -> RosGraph:
    """Return the graph without observers and without topics and services that only they use.

    ``/transform_listener_impl_<address>`` become ``/transform_listener_impl_0``, ``_1``, ..., in
    the order of their neighbours, so that equal systems have equal views.
    """
    observers = [
        vertex
        for vertex, data in graph.nodes(data=True)
        if data["kind"] == "node" and _OBSERVERS.fullmatch(data["label"])
    ]
    view: RosGraph = graph.copy()
    view.remove_nodes_from(observers)
    view.remove_nodes_from(
        [
            vertex
            for vertex, data in graph.nodes(data=True)
            if data["kind"] != "node" and view.degree(vertex) == 0 and graph.degree(vertex) > 0
        ]
    )
    return _numbered(view)


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


def _numbered(graph: RosGraph) -> RosGraph:
    """Replace generated names by numbers."""

    def neighbours(vertex: str) -> tuple[list[str], list[str], str]:
        return sorted(graph.predecessors(vertex)), sorted(graph.successors(vertex)), vertex

    count: dict[str, int] = {}
    names: dict[str, str] = {}
    generated = [v for v in graph if _GENERATED_SUFFIX.fullmatch(graph.nodes[v]["label"])]
    for vertex in sorted(generated, key=neighbours):
        stem = _GENERATED_SUFFIX.sub(r"\1", graph.nodes[vertex]["label"])
        names[vertex] = f"{stem}_{count.get(stem, 0)}"
        count[stem] = count.get(stem, 0) + 1
    kinds = {vertex: graph.nodes[vertex]["kind"] for vertex in names}
    if not names:
        return graph
    import networkx as nx

    view: RosGraph = nx.relabel_nodes(
        graph, {vertex: vertex_id(kinds[vertex], name) for vertex, name in names.items()}
    )
    for vertex, name in names.items():
        view.nodes[vertex_id(kinds[vertex], name)]["label"] = name
    return view
