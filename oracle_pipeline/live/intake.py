"""Receives the messages of a DDS domain as bytes, into a bounded queue.

A separate thread receives them, so each gets its time of arrival at once. If the queue is full, the
newest messages are dropped; if the thread is too slow, DDS drops the oldest. Both are counted. A
robot never waits for the watch: readers keep only the last messages, so a full queue here does not
fill the robot's queues.
"""

import threading
import time
from collections import Counter
from typing import NamedTuple

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosReliability

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import dds_topic
from oracle_pipeline.bags.errors import DdsError
from oracle_pipeline.bags.qos_profiles import compatible
from oracle_pipeline.live.discovery import ENTITIES_QOS

QUEUE_BYTES = 64 * 2**20  # of waiting messages, at most
PACKETS_S = 1.0  # between two counts of lost packets, which take a millisecond each
_DEPTH = 500  # history depth of a DDS reader
_WAIT_S = 0.2  # at most, until the thread checks for new readers or its end


class Received(NamedTuple):
    """A message as received."""

    topic: str
    sent_ns: int  # by the sender's clock [ns since 1970]
    wall_ns: int  # when it arrived, by our clock [ns since 1970]
    steady_ns: int  # the same by our steady clock, which nobody sets [ns]
    writer: int  # handle of the endpoint that sent it
    data: bytes  # CDR with its encapsulation header


class Intake:
    """Subscribes to topics and queues their messages.

    Parameters
    ----------
    participant
        Owner of the readers.
    queue_bytes : int
        Size of the queue [B].

    Attributes
    ----------
    topics : dict of str to str
        Message type of each subscribed topic.
    """

    def __init__(self, participant: dds.Participant, queue_bytes: int = QUEUE_BYTES) -> None:
        self.topics: dict[str, str] = {}
        self._participant = participant
        self._most_bytes = queue_bytes
        self._ready = dds.ReadyReaders(participant)
        self._requested: dict[str, Qos] = {}
        self._names: dict[dds.RawReader, str] = {}
        self._queue: list[Received] = []
        self._bytes = 0
        self._lost: Counter[str] = Counter()
        self._packets, self._counted_s = dds.dropped_packets(), time.monotonic()
        self._lock = threading.Lock()
        self._ended = False
        self._error: DdsError | None = None
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

    def take(self) -> list[Received]:
        """Return the queued messages, in order of arrival.

        Raises
        ------
        DdsError
            If messages can no longer be received.
        """
        with self._lock:
            if self._error is not None and not self._queue:
                raise self._error
            taken, self._queue, self._bytes = self._queue, [], 0
        return taken

    def lost(self) -> Counter[str]:
        """Return how many messages of each topic were lost since the last call.

        Either the queue was full, or the reader's history was.
        """
        with self._lock:
            lost, self._lost = self._lost, Counter()
        return lost

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
                came.sort(
                    key=lambda each: each.sent_ns
                )  # in sending order, if the senders' clocks agree
                self._put(came)
        except DdsError as error:
            with self._lock:
                self._error = error

    def _taken(self, reader: dds.RawReader) -> list[dds.Raw]:
        """Take from a reader, and count what it lost meanwhile."""
        before, taken = reader.lost, reader.take()
        if lost := reader.lost - before:
            with self._lock:
                self._lost[self._names[reader]] += lost
        return taken

    def _put(self, came: list[Received]) -> None:
        with self._lock:
            for received in came:
                if self._bytes + len(received.data) > self._most_bytes:
                    self._lost[received.topic] += 1
                else:
                    self._queue.append(received)
                    self._bytes += len(received.data)
