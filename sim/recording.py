"""The recorder: records what ``ros2 bag record -a`` would, and the ROS graph every 10 s.

Bag stamps are simulated time at receipt unless asked otherwise. The graph of an interval has the
nodes and topics that exist at its end, and the traffic of each edge during the interval. Hidden
topics are in no graph.
"""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import networkx as nx
import numpy as np

from oracle_pipeline.bags.graph_files import (
    RosGraph,
    VertexKind,
    add_traffic,
    vertex_id,
    write_gexf,
    write_graphml,
)
from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S, is_hidden
from oracle_pipeline.bags.qos_profiles import is_latched, is_reliable
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.bags.writer import BagWriter
from sim.middleware import qos
from sim.middleware.domain import Domain, Offers
from sim.middleware.endpoints import Publisher, Subscription
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node

INTERVAL_NS = INTERVAL_S * SECOND
SHORTEST_INTERVAL_NS = MIN_INTERVAL_S * SECOND
DEBUG_TOPICS = ("/evaluation", "/marker")  # of the controller, which publishes nothing on them
_DISCOVERY_NS = 100 * MILLISECOND  # rosbag2 looks for new topics this often

_Counts: TypeAlias = dict[Publisher | Subscription, tuple[int, int]]  # messages and bytes


class Recorder(Node):
    """Subscribes to every visible topic when it appears, and writes its messages.

    Parameters
    ----------
    domain
        The domain to record.
    writer
        Open bag.
    leave_out
        Topics that are not recorded (``ros2 bag record --exclude``).
    hidden_topics
        Whether hidden topics are recorded (``--include-hidden-topics``).
    receive_clock
        Gives the bag's stamps; simulated time (``--use-sim-time``) if omitted.
    """

    def __init__(
        self,
        domain: Domain,
        writer: BagWriter,
        *,
        leave_out: Collection[str] = (),
        hidden_topics: bool = False,
        receive_clock: "ReceiveClock | None" = None,
    ) -> None:
        super().__init__(domain, "/rosbag2_recorder", endpoints="E")
        self._writer = writer
        self._leave_out = leave_out
        self._hidden_topics = hidden_topics
        self._receive_clock = receive_clock
        self._endpoints: dict[str, int] = {}  # topic -> publishers whose QoS is in the bag
        self._revision = 0  # of the domain at the last search for topics
        self._received: list[tuple[int, str, bytes]] = []  # and not yet in the bag
        self.create_publisher("rosbag2_interfaces/msg/WriteSplitEvent", "/events/write_split")
        self._discover()
        self.create_timer(_DISCOVERY_NS, self._discover)
        self.create_timer(SECOND, self.store)

    def store(self) -> None:
        """Write the messages received so far into the bag."""
        if not self._received:
            return
        times_ns, topics, data = zip(*self._received, strict=True)
        self._received.clear()
        if self._receive_clock is not None:
            times_ns = tuple(map(self._receive_clock.stamp_ns, times_ns))
        self._writer.write_many(topics, times_ns, data)

    def _discover(self) -> None:
        if self._revision == self.domain.revision:
            return
        self._revision = self.domain.revision
        self.store()  # profiles offered from now on are stored for topics without a message only
        for topic, msgtype in list(self.domain.topics.items()):
            if topic in self._leave_out or not self._is_wanted(topic):
                continue
            offered = [publisher.qos for publisher in self.domain.publishers(topic)]
            known = self._endpoints.get(topic, 0)
            if len(offered) > known:
                self._writer.add_topic(topic, msgtype, offered[known:])
                self._endpoints[topic] = len(offered)
                if known == 0:
                    self._subscribe(topic, msgtype, offered)

    def _is_wanted(self, topic: str) -> bool:
        return self._hidden_topics or topic == GROUND_TRUTH_TOPIC or not is_hidden(topic)

    def _subscribe(self, topic: str, msgtype: str, offered: list[Any]) -> None:
        reliable = all(is_reliable(profile) for profile in offered)
        latched = all(is_latched(profile) for profile in offered)
        requested = qos.profile(10, reliable=reliable, latched=latched)

        executor, received = self.domain.executor, self._received.append

        def receive(data: bytes) -> None:
            received((executor.now_ns, topic, data))

        self.create_subscription(msgtype, topic, receive, requested, raw=True)


class ReceiveClock:
    """The recorder's wall clock: the arrival time of a message, in nanoseconds since 1970.

    It runs as fast as simulated time; each message takes its own time to arrive.

    Parameters
    ----------
    start_ns
        Simulated time at which it shows ``EPOCH_NS``.
    rng
        Draws how long messages take.
    """

    EPOCH_NS = 1_767_225_600 * SECOND  # 2026-01-01 00:00 UTC
    _MEAN_DELAY_NS = 0.3 * MILLISECOND

    def __init__(self, start_ns: int, rng: np.random.Generator) -> None:
        self._offset_ns = self.EPOCH_NS - start_ns
        self._rng = rng
        self._last_ns = 0

    def stamp_ns(self, now_ns: int) -> int:
        """Return the stamp of a message that is sent now; never earlier than the last one."""
        delay_ns = int(self._rng.exponential(self._MEAN_DELAY_NS))
        self._last_ns = max(self._last_ns, self._offset_ns + now_ns + delay_ns)
        return self._last_ns


class GraphRecorder:
    """Writes the graph of every interval while a run goes on, and that of the whole run.

    Parameters
    ----------
    domain
        The domain whose graph is written.
    folder
        An existing, empty folder.
    """

    def __init__(self, domain: Domain, folder: Path) -> None:
        self._domain = domain
        self._folder = folder
        self._start_ns = domain.executor.now_ns
        self._interval_ns = self._start_ns
        self._begun = self._before = self._counts()
        domain.executor.call_at(self._start_ns + INTERVAL_NS, self._end_interval)

    def finish(self) -> None:
        """Write the last interval if it is long enough, and the graphs of the run."""
        counts = self._counts()
        if self._domain.executor.now_ns - self._interval_ns >= SHORTEST_INTERVAL_NS:
            self._write_interval(counts)
        run = self._graph(self._begun, counts)
        write_gexf(run, self._folder / "run.gexf")
        write_graphml(run, self._folder / "run.graphml")
        write_gexf(self._full(run), self._folder / "full.gexf")

    def _end_interval(self) -> None:
        counts = self._counts()
        self._write_interval(counts)
        self._before = counts
        self._interval_ns += INTERVAL_NS
        self._domain.executor.call_at(self._interval_ns + INTERVAL_NS, self._end_interval)

    def _write_interval(self, counts: _Counts) -> None:
        second = (self._interval_ns - self._start_ns) // SECOND
        write_gexf(self._graph(self._before, counts), self._folder / f"{second:06d}.gexf")

    def _graph(self, before: _Counts, counts: _Counts) -> RosGraph:
        """Return the present graph with the traffic between two counts."""
        graph: RosGraph = nx.DiGraph()
        for name in self._domain.node_names():
            graph.add_node(vertex_id("node", name), kind="node", type="", label=name)
        for topic, msgtype in self._domain.topics.items():
            if not is_hidden(topic):
                graph.add_node(vertex_id("topic", topic), kind="topic", type=msgtype, label=topic)
        for endpoint, (messages, size) in counts.items():
            node, topic = vertex_id("node", endpoint.node), vertex_id("topic", endpoint.topic)
            ends = (node, topic) if isinstance(endpoint, Publisher) else (topic, node)
            messages_before, size_before = before.get(endpoint, (0, 0))
            add_traffic(graph, *ends, messages - messages_before, size - size_before)
        return graph

    def _full(self, run: RosGraph) -> RosGraph:
        """Return the graph of the run with services and actions.

        Edges run from the client to the service or action, and from there to its server. Requests
        stay inside the process, so their traffic is 0.
        """
        graph: RosGraph = run.copy()
        kinds: tuple[tuple[VertexKind, Offers], ...]
        kinds = ("service", self._domain.services), ("action", self._domain.actions)
        for kind, offers in kinds:
            for offer, clients in offers:
                if is_hidden(offer.name):  # the services of an action, which has a vertex itself
                    continue
                vertex = vertex_id(kind, offer.name)
                graph.add_node(vertex, kind=kind, type=offer.type, label=offer.name)
                add_traffic(graph, vertex, vertex_id("node", offer.node), 0, 0)
                for client in clients:
                    add_traffic(graph, vertex_id("node", client), vertex, 0, 0)
        return graph

    def _counts(self) -> _Counts:
        """Return what the endpoints of visible topics have sent or received so far."""
        return {
            endpoint: (endpoint.messages, endpoint.message_bytes)
            for endpoint in self._endpoints()
            if not is_hidden(endpoint.topic)
        }

    def _endpoints(self) -> Iterator[Publisher | Subscription]:
        yield from self._domain.publishers()
        yield from self._domain.subscriptions()
