"""Receives the messages of a DDS domain as bytes, into a bounded queue.

A separate thread waits for them, so each gets its time of arrival at once. If they are not taken
fast enough, the newest are dropped and counted. A robot never waits for the watch: readers keep
only the last messages, so a full queue here fills no queue there.
"""

import threading
import time
from collections import Counter
from typing import NamedTuple

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.interfaces import QosTime as _QosTime

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import dds_topic
from oracle_pipeline.bags.errors import DdsError
from oracle_pipeline.bags.qos_profiles import compatible, is_latched

QUEUE_BYTES = 64 * 2**20  # of messages that wait at most
_DEPTH = 500  # messages of a topic that wait in DDS, until the thread takes them
_WAIT_S = 0.2  # at most, until the thread looks for new readers or its end
_NO_LIMIT = _QosTime(9223372036, 854775807)


class Received(NamedTuple):
    """A message as it came."""

    topic: str
    sent_ns: int  # by the sender's clock [ns since 1970]
    wall_ns: int  # when it came, by ours
    writer: int  # handle of the endpoint that sent it
    data: bytes  # CDR with its encapsulation header


class Intake:
    """Hears topics.

    Parameters
    ----------
    participant
        Where the readers live.
    queue_bytes : int
        Size of the queue [B].

    Attributes
    ----------
    topics : dict of str to str
        What is heard: topic -> message type.
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
        self._dropped: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._ended = False
        self._error: DdsError | None = None
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self._thread.start()

    def hear(self, topic: str, msgtype: str, *, reliable: bool, latched: bool) -> None:
        """Subscribe to a topic.

        Raises
        ------
        DdsError
            If its type is not known.
        """
        qos = Qos(
            QosHistory.KEEP_LAST,
            _DEPTH,
            QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
            QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
            _NO_LIMIT,
            _NO_LIMIT,
            QosLiveliness.AUTOMATIC,
            _NO_LIMIT,
            avoid_ros_namespace_conventions=False,
        )
        reader = dds.RawReader(self._participant, dds_topic(topic), msgtype, qos)
        self.topics[topic] = msgtype
        self._requested[topic] = qos
        self._names[reader] = topic
        self._ready.add(reader)

    def hears(self, topic: str, offered: Qos) -> bool:
        """Tell whether a publisher's profile fits what we asked for."""
        return compatible(offered, self._requested[topic])

    def is_latched(self, topic: str) -> bool:
        """Tell whether we asked for what was said before we came."""
        return is_latched(self._requested[topic])

    def take(self) -> list[Received]:
        """Return what has come, in order of arrival.

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

    def dropped(self) -> Counter[str]:
        """Return how many messages of each topic were dropped since this was last asked."""
        with self._lock:
            dropped, self._dropped = self._dropped, Counter()
        return dropped

    def close(self) -> None:
        """Stop; what was not taken stays in the queue."""
        self._ended = True
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._ended:
                ready = self._ready.wait(_WAIT_S)
                wall_ns = time.time_ns()
                came = [
                    Received(self._names[reader], raw.source_ns, wall_ns, raw.writer, raw.data)
                    for reader in ready
                    for raw in reader.take()
                ]
                came.sort(key=lambda each: each.sent_ns)  # as sent, if senders' clocks agree
                self._put(came)
        except DdsError as error:
            with self._lock:
                self._error = error

    def _put(self, came: list[Received]) -> None:
        with self._lock:
            for received in came:
                if self._bytes + len(received.data) > self._most_bytes:
                    self._dropped[received.topic] += 1
                else:
                    self._queue.append(received)
                    self._bytes += len(received.data)
