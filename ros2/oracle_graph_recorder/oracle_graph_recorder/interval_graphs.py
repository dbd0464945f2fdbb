"""Interval graphs from rclpy's graph API, in the format of the recorder.

The node passes itself to this module, which does not import rclpy, so tests run it without ROS.
"""

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Protocol

import networkx as nx

from oracle_pipeline.bags.graph_files import (
    RosGraph,
    add_traffic,
    vertex_id,
    write_gexf,
    write_graphml,
)
from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S, is_hidden
from oracle_pipeline.graphs.intervals import compose

UNKNOWN = "_NODE_NAME_UNKNOWN_"  # ROS 2's name for an endpoint without a known node
_SECOND_NS = 1_000_000_000


class EndpointInfo(Protocol):
    """The used part of ``rclpy.topic_endpoint_info.TopicEndpointInfo``."""

    @property
    def node_name(self) -> str:
        """Name of the node, without its namespace."""

    @property
    def node_namespace(self) -> str:
        """Namespace, ``/`` for the root."""

    @property
    def qos_profile(self) -> Any:
        """Offered or requested quality of service."""


class GraphApi(Protocol):
    """The used part of ``rclpy.node.Node``."""

    def get_node_names_and_namespaces(self) -> Sequence[tuple[str, str]]:
        """Return name and namespace of each node."""

    def get_topic_names_and_types(self) -> Sequence[tuple[str, Sequence[str]]]:
        """Return each topic and its types."""

    def get_publishers_info_by_topic(self, topic_name: str) -> Sequence[EndpointInfo]:
        """Return the publishers of a topic."""

    def get_subscriptions_info_by_topic(self, topic_name: str) -> Sequence[EndpointInfo]:
        """Return the subscriptions to a topic."""


class Traffic:
    """Messages and bytes of each topic since the interval began."""

    def __init__(self) -> None:
        self.messages: Counter[str] = Counter()
        self.bytes: Counter[str] = Counter()

    def count(self, topic: str, size: int) -> None:
        """Count a message by its topic and its serialized size [bytes]."""
        self.messages[topic] += 1
        self.bytes[topic] += size


def snapshot(
    api: GraphApi,
    traffic: Traffic,
    compatible: Callable[[Any, Any], bool],
    leave_out: Collection[str] = (),
) -> RosGraph:
    """Return the current graph with the traffic of each edge; hidden topics are left out.

    rclpy does not provide the sender of a message. So the messages of a topic are divided evenly
    among its publishers; their sum is exact, and with a single publisher each part is.

    Parameters
    ----------
    api : GraphApi
    traffic : Traffic
    compatible : callable
        Takes an offered and a requested QoS profile, and returns whether they are compatible.
    leave_out : collection of str
        Full names of nodes that are not part of the system, such as the recorder.
    """
    graph: RosGraph = nx.DiGraph()
    for name, namespace in api.get_node_names_and_namespaces():
        if (full := full_name(name, namespace)) not in leave_out:
            graph.add_node(vertex_id("node", full), kind="node", type="", label=full)
    for topic, types in api.get_topic_names_and_types():
        if is_hidden(topic):
            continue
        publishers = _outside(api.get_publishers_info_by_topic(topic), leave_out)
        subscriptions = _outside(api.get_subscriptions_info_by_topic(topic), leave_out)
        if not publishers and not subscriptions:
            continue
        vertex = vertex_id("topic", topic)
        graph.add_node(vertex, kind="topic", type=min(types), label=topic)
        shares = list(
            zip(
                _divided(traffic.messages[topic], len(publishers)),
                _divided(traffic.bytes[topic], len(publishers)),
                strict=True,
            )
        )
        for publisher, (messages, size) in zip(publishers, shares, strict=True):
            add_traffic(graph, _vertex(graph, publisher), vertex, messages, size)
        for subscription in subscriptions:
            received = [
                share
                for publisher, share in zip(publishers, shares, strict=True)
                if compatible(publisher.qos_profile, subscription.qos_profile)
            ]
            node = _vertex(graph, subscription)
            add_traffic(
                graph, vertex, node, sum(m for m, _ in received), sum(b for _, b in received)
            )
    return graph


def full_name(name: str, namespace: str) -> str:
    """Return the full name of a node.

    Examples
    --------
    >>> full_name("amcl", "/"), full_name("amcl", "/robot1")
    ('/amcl', '/robot1/amcl')
    >>> full_name("_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_")
    '/_NODE_NAME_UNKNOWN_'
    """
    return f"/{UNKNOWN}" if name == UNKNOWN else f"{namespace.rstrip('/')}/{name}"


class IntervalGraphs:
    """Writes the graph of every interval of 10 s, and that of the whole recording.

    Parameters
    ----------
    take : callable
        Returns the graph of an interval that ends now, given its traffic.
    folder : Path
        Folder for ``000000.gexf``, ``000010.gexf``, ... and ``run.gexf``; it is created.
    start_ns : int
        Start of the recording.
    """

    def __init__(self, take: Callable[[Traffic], RosGraph], folder: Path, start_ns: int) -> None:
        self.traffic = Traffic()
        self._take = take
        self._folder = folder
        self._start_ns = start_ns
        self._ended = 0  # intervals
        self._run: RosGraph = compose(())
        folder.mkdir(parents=True, exist_ok=True)

    def pass_to(self, now_ns: int) -> None:
        """Advance time, and write the intervals that have ended."""
        while now_ns - self._start_ns >= (self._ended + 1) * INTERVAL_S * _SECOND_NS:
            self._end_interval()

    def finish(self, now_ns: int) -> None:
        """Write the last interval if it is long enough, and the graph of the recording."""
        self.pass_to(now_ns)
        rest_ns = now_ns - self._start_ns - self._ended * INTERVAL_S * _SECOND_NS
        if rest_ns >= MIN_INTERVAL_S * _SECOND_NS:
            self._end_interval()
        write_gexf(self._run, self._folder / "run.gexf")
        write_graphml(self._run, self._folder / "run.graphml")

    def _end_interval(self) -> None:
        graph = self._take(self.traffic)
        write_gexf(graph, self._folder / f"{self._ended * INTERVAL_S:06d}.gexf")
        self._run = compose((self._run, graph))
        self.traffic = Traffic()
        self._ended += 1


def _outside(endpoints: Sequence[EndpointInfo], leave_out: Collection[str]) -> list[EndpointInfo]:
    return [e for e in endpoints if full_name(e.node_name, e.node_namespace) not in leave_out]


def _vertex(graph: RosGraph, endpoint: EndpointInfo) -> str:
    """Return the vertex of an endpoint's node; it is added if missing."""
    name = full_name(endpoint.node_name, endpoint.node_namespace)
    vertex = vertex_id("node", name)
    graph.add_node(vertex, kind="node", type="", label=name)
    return vertex


def _divided(total: int, parts: int) -> list[int]:
    """Divide an integer into nearly equal parts.

    Examples
    --------
    >>> _divided(7, 3)
    [3, 2, 2]
    """
    if not parts:
        return []
    each, rest = divmod(total, parts)
    return [each + (number < rest) for number in range(parts)]
