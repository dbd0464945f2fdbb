"""The mode's node on a real DDS domain.

It is the node of the simulated testbeds, in a small domain of its own. What arrives on DDS is
published there, and what the node publishes there is sent on DDS. So a scenario does the same to a
live system as to a simulated one. In place, the node is a second publisher: it adds the altered
messages, and cannot take back the originals.
"""

import time
from collections.abc import Callable

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_discovery import DdsDiscovery
from oracle_pipeline.bags.dds_names import dds_topic
from oracle_pipeline.bags.types import deserialize, serialize
from sim.fuzzing.execution import Execution
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.endpoints import Publisher
from sim.middleware.executor import Executor
from sim.middleware.stamps import stamp_ns
from sim.serving import NodeAnnouncer

NODE = "/oracle_relay"
_OUTSIDE = "/outside"  # owner of what arrives, which is on no DDS domain
_CLOCK = ("/clock", "rosgraph_msgs/msg/Clock")
_PAUSE_S = 0.01  # that it waits for messages


class LiveNode:
    """Executes a scenario on a DDS domain; call `work` again and again.

    Attributes
    ----------
    discovery : DdsDiscovery
        Of the same domain.
    domain : Domain
        In which the node is.
    node : ScenarioNode or None
        None until it joins.
    is_awaited_here : bool
        Whether an awaited message has arrived.
    """

    def __init__(self, number: int, execution: Execution) -> None:
        self._participant = dds.join(number)
        self.discovery = DdsDiscovery(self._participant)
        self.domain = Domain(Executor())
        self.node: ScenarioNode | None = None
        self.is_awaited_here = False
        self._awaited: dds.RawReader | None = None
        self._execution = execution
        self._onset_ns: int | None = None  # None: not known yet, and neither is the time
        self._announcer = NodeAnnouncer(self._participant)
        self._ready = dds.ReadyReaders(self._participant)
        self._arriving: dict[dds.RawReader, Publisher] = {}
        self._sent: list[dds.RawWriter] = []  # keep what late subscribers get
        self._clock = self._reader(*_CLOCK)
        self._simulated_ns: int | None = None
        self._received = b""  # of the message that is processed

    def join(self) -> None:
        """Add the node to the domain, there and on DDS."""
        program = self._execution.program
        owner = NODE if program.is_in_place else _OUTSIDE
        topics = {lane.input_topic: lane.type.name for lane in program.lanes}
        topics |= {source.topic: source.type.name for source in program.sources.values()}
        for topic, msgtype in topics.items():
            publisher = self.domain.add_publisher(owner, msgtype, topic, qos.DEFAULT)
            self._arriving[self._reader(topic, msgtype)] = publisher
        self.node = ScenarioNode(self.domain, NODE, self._execution)
        writers = []
        for topic, kind in program.outlets.items():
            writer = dds.RawWriter(self._participant, dds_topic(topic), kind.name, qos.DEFAULT)
            writers.append((NODE, writer))
            for publisher in self.domain.publishers(topic):
                publisher.tap(self._sender(publisher, writer))
        readers = [(NODE, reader) for reader in self._arriving]
        self._announcer.publish([NODE], readers, writers)

    def begin(self, onset_ns: int) -> None:
        """Let the scenario act from a time on; a node that has not joined does so then."""
        self._onset_ns = onset_ns
        if self.node is not None:
            self._advance()
            self.node.begin(max(onset_ns, self.domain.executor.now_ns))

    def await_message(self, topic: str, msgtype: str) -> None:
        """Subscribe to a topic, and take note when it has a message."""
        self._awaited = self._reader(topic, msgtype)

    def publish(self, topic: str, msgtype: str, data: bytes) -> None:
        """Publish a message that late subscribers get as well."""
        writer = dds.RawWriter(self._participant, dds_topic(topic), msgtype, qos.LATCHED)
        self._sent.append(writer)
        writer.write(data)

    @property
    def now_ns(self) -> int:
        """Time of the system: that of ``/clock`` if it is published, else ours."""
        return time.time_ns() if self._simulated_ns is None else self._simulated_ns

    def work(self) -> None:
        """Process what has arrived and what is due, or wait for a moment."""
        self.discovery.update()
        for reader in self._ready.wait(_PAUSE_S):
            for raw in reader.take():
                self._take(reader, raw)
        self._advance()
        if self.node is None and self._onset_ns is not None and self.now_ns >= self._onset_ns:
            self.join()
            self.begin(self._onset_ns)

    def close(self) -> None:
        """Leave the domain."""
        dds.leave(self._participant)

    def _take(self, reader: dds.RawReader, raw: dds.Raw) -> None:
        if reader is self._clock:
            self._simulated_ns = stamp_ns(deserialize(raw.data, _CLOCK[1]).clock)
        elif reader is self._awaited:
            self.is_awaited_here = True
        else:
            self._advance()
            self._received = raw.data
            self._arriving[reader].publish_serialized(raw.data)
            self._advance()

    def _advance(self) -> None:
        executor = self.domain.executor
        now_ns = executor.now_ns if self._onset_ns is None else self.now_ns
        executor.run_until(max(now_ns, executor.now_ns))

    def _sender(self, publisher: Publisher, writer: dds.RawWriter) -> Callable[[bytes], None]:
        """Return what sends the node's messages on DDS."""

        def send_altered(data: bytes) -> None:
            received = deserialize(self._received, publisher.msgtype)
            if data != serialize(received, publisher.msgtype):
                writer.write(data)

        inputs = {lane.input_topic for lane in self._execution.program.lanes}
        return send_altered if publisher.topic in inputs else writer.write

    def _reader(self, topic: str, msgtype: str) -> dds.RawReader:
        profile = qos.profile(100, reliable=False)
        reader = dds.RawReader(
            self._participant, dds_topic(topic), msgtype, profile, others_only=True
        )
        self._ready.add(reader)
        return reader
