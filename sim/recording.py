"""The recorder: what ``ros2 bag record -a`` would have taken, and the ROS graph every 10 s.

Bag stamps are seconds of simulated time at receipt. The graph of an interval holds who was there
at its end and what went over each edge during it; hidden topics are in no graph.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import networkx as nx

from oracle_pipeline.bags.graph_files import RosGraph, vertex_id, write_gexf, write_graphml
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.bags.writer import BagWriter
from sim.middleware import qos
from sim.middleware.domain import Domain, Publisher, Subscription, is_hidden
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node

INTERVAL_NS = 10 * SECOND
SHORTEST_INTERVAL_NS = 5 * SECOND  # a last, partial interval shorter than this is dropped
_DISCOVERY_NS = 100 * MILLISECOND  # rosbag2 looks for new topics this often


class Recorder(Node):
    """Subscribes to every visible topic as it appears and writes what it hears.

    Parameters
    ----------
    domain
        What to record.
    writer
        Open bag.
    """

    def __init__(self, domain: Domain, writer: BagWriter) -> None:
        super().__init__(domain, "/rosbag2_recorder", endpoints="E")
        self._writer = writer
        self._endpoints: dict[str, int] = {}  # topic -> publishers whose QoS is in the bag
        self._revision = 0  # of the domain when it was last looked through
        self.create_publisher("rosbag2_interfaces/msg/WriteSplitEvent", "/events/write_split")
        self._discover()
        self.create_timer(_DISCOVERY_NS, self._discover)

    def _discover(self) -> None:
        if self._revision == self.domain.revision:
            return
        self._revision = self.domain.revision
        for topic, msgtype in list(self.domain.topics.items()):
            if is_hidden(topic) and topic != GROUND_TRUTH_TOPIC:
                continue
            offered = [publisher.qos for publisher in self.domain.publishers(topic)]
            known = self._endpoints.get(topic, 0)
            if len(offered) > known:
                self._writer.add_topic(topic, msgtype, offered[known:])
                self._endpoints[topic] = len(offered)
                if known == 0:
                    self._subscribe(topic, msgtype, offered)

    def _subscribe(self, topic: str, msgtype: str, offered: list[Any]) -> None:
        reliable = all(qos.is_reliable(profile) for profile in offered)
        latched = all(qos.is_latched(profile) for profile in offered)
        requested = qos.profile(10, reliable=reliable, latched=latched)

        def write(data: bytes) -> None:
            self._writer.write(topic, self.now_ns, data)

        self.create_subscription(msgtype, topic, write, requested, raw=True)


class GraphRecorder:
    """Writes the graph of every interval while a run goes on, and that of the whole run.

    Parameters
    ----------
    domain
        Whose graph.
    folder
        An existing, empty folder.
    """

    def __init__(self, domain: Domain, folder: Path) -> None:
        self._domain = domain
        self._folder = folder
        self._start_ns = domain.executor.now_ns
        self._interval_ns = self._start_ns
        self._run: RosGraph = nx.DiGraph()
        self._seen: dict[Publisher | Subscription, tuple[int, int]] = {}
        for endpoint in self._endpoints():  # what was sent before the recording does not count
            self._traffic(endpoint)
        domain.executor.call_at(self._start_ns + INTERVAL_NS, self._end_interval)

    def finish(self) -> None:
        """Write the last interval if it is long enough, and the graph of the run."""
        if self._domain.executor.now_ns - self._interval_ns >= SHORTEST_INTERVAL_NS:
            self._write_interval()
        write_gexf(self._run, self._folder / "run.gexf")
        write_graphml(self._run, self._folder / "run.graphml")

    def _end_interval(self) -> None:
        self._write_interval()
        self._interval_ns += INTERVAL_NS
        self._domain.executor.call_at(self._interval_ns + INTERVAL_NS, self._end_interval)

    def _write_interval(self) -> None:
        graph = self._snapshot()
        second = (self._interval_ns - self._start_ns) // SECOND
        write_gexf(graph, self._folder / f"{second:06d}.gexf")
        self._run.add_nodes_from(graph.nodes(data=True))
        for source, target, traffic in graph.edges(data=True):
            _count(self._run, source, target, traffic["messages"], traffic["bytes"])

    def _snapshot(self) -> RosGraph:
        graph: RosGraph = nx.DiGraph()
        for name in self._domain.node_names():
            graph.add_node(vertex_id("node", name), kind="node", type="", label=name)
        for topic, msgtype in self._domain.topics.items():
            if not is_hidden(topic):
                graph.add_node(vertex_id("topic", topic), kind="topic", type=msgtype, label=topic)
        for endpoint in self._endpoints():
            node, topic = vertex_id("node", endpoint.node), vertex_id("topic", endpoint.topic)
            ends = (node, topic) if isinstance(endpoint, Publisher) else (topic, node)
            _count(graph, *ends, *self._traffic(endpoint))
        return graph

    def _endpoints(self) -> Iterator[Publisher | Subscription]:
        yield from (p for p in self._domain.publishers() if not is_hidden(p.topic))
        yield from (s for s in self._domain.subscriptions() if not is_hidden(s.topic))

    def _traffic(self, endpoint: Publisher | Subscription) -> tuple[int, int]:
        """Return messages and bytes since the last look."""
        messages, size = self._seen.get(endpoint, (0, 0))
        self._seen[endpoint] = (endpoint.messages, endpoint.message_bytes)
        return endpoint.messages - messages, endpoint.message_bytes - size


def _count(graph: RosGraph, source: str, target: str, messages: int, size: int) -> None:
    """Add traffic to an edge; several endpoints of one node on one topic are one edge."""
    if not graph.has_edge(source, target):
        graph.add_edge(source, target, messages=0, bytes=0)
    edge = graph.edges[source, target]
    edge["messages"] += messages
    edge["bytes"] += size
