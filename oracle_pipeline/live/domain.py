"""A DDS domain as a source of messages, which it receives as bytes.

A separate thread receives them, so each gets its time of arrival at once. If the queue is full, the
newest messages are dropped; if the thread is too slow, DDS drops the oldest. Both are counted. A
robot never waits for the watch: readers keep only the last messages, so a full queue here does not
fill the robot's queues.
"""

import threading
import time

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosReliability

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_discovery import DdsDiscovery
from oracle_pipeline.bags.dds_names import dds_topic
from oracle_pipeline.bags.discovery import ENTITIES_QOS
from oracle_pipeline.bags.errors import DdsError
from oracle_pipeline.bags.qos_profiles import compatible
from oracle_pipeline.live.intake import PACKETS_S, Intake, Received
from oracle_pipeline.live.source import Source
from oracle_pipeline.live.trigger_service import TriggerService

_DEPTH = 500  # history depth of a DDS reader
_WAIT_S = 0.2  # at most, until the thread checks for new readers or its end


class Domain(Source):
    """Joins a domain, and only reads; its only writer there is that of a service.

    Parameters
    ----------
    number : int
        Of the domain.
    service : str
        Name of a `TriggerService`; empty for none.
    """

    def __init__(self, number: int, service: str = "") -> None:
        self._participant = dds.join(number)
        self._service = TriggerService(self._participant, service) if service else None
        intake = _DdsIntake(self._participant)
        super().__init__({"domain": number}, DdsDiscovery(self._participant), intake)

    def calls(self) -> int:
        """Answer the calls of the service since the last time, and return their number."""
        return self._service.calls() if self._service is not None else 0

    def close(self) -> None:
        """Stop receiving, and leave the domain."""
        self.intake.close()
        dds.leave(self._participant)


class _DdsIntake(Intake):
    """Subscribes to topics of a domain, and queues their messages.

    Parameters
    ----------
    participant
        Owner of the readers.
    """

    def __init__(self, participant: dds.Participant) -> None:
        super().__init__()
        self._participant = participant
        self._ready = dds.ReadyReaders(participant)
        self._requested: dict[str, Qos] = {}
        self._names: dict[dds.RawReader, str] = {}
        self._packets, self._counted_s = dds.dropped_packets(), time.monotonic()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, msgtype: str, *, reliable: bool, latched: bool) -> None:
        """Subscribe to a topic.

        Raises
        ------
        DdsError
            If its type is unknown.
        """
        qos = ENTITIES_QOS._replace(
            history=QosHistory.KEEP_LAST,
            depth=_DEPTH,
            reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
            durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        )
        reader = dds.RawReader(self._participant, dds_topic(topic), msgtype, qos)
        self.topics[topic] = msgtype
        self._requested[topic] = qos
        self._names[reader] = topic
        self._ready.add(reader)

    def accepts(self, topic: str, offered: Qos) -> bool:
        """Return whether a publisher's QoS is compatible with our subscription's."""
        return compatible(offered, self._requested[topic])

    def lost_packets(self) -> int:
        """Return how many packets found the network buffers full; counted every `PACKETS_S`."""
        if time.monotonic() - self._counted_s < PACKETS_S:
            return 0
        before = self._packets
        self._packets, self._counted_s = dds.dropped_packets(), time.monotonic()
        return max(0, self._packets - before)

    def close(self) -> None:
        """Stop receiving; messages that were not taken stay in the queue."""
        self._ended = True
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._ended:
                ready = self._ready.wait(_WAIT_S)
                now = time.time_ns(), time.monotonic_ns()
                came = [
                    Received(self._names[reader], raw.source_ns, *now, raw.writer, raw.data)
                    for reader in ready
                    for raw in self._taken(reader)
                ]
                # In sending order, if the senders' clocks agree.
                came.sort(key=lambda each: each.sent_ns)
                self.put(came)
        except DdsError as error:
            with self._lock:
                self._error = error

    def _taken(self, reader: dds.RawReader) -> list[dds.Raw]:
        """Take from a reader, and count what it lost meanwhile."""
        before, taken = reader.lost, reader.take()
        self.count_lost(self._names[reader], reader.lost - before)
        return taken
