"""A bounded queue of messages as bytes, between their source and the watch.

If it is full, the newest messages are dropped, and counted by topic.
"""

import threading
from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from rosbags.interfaces import Qos

from oracle_pipeline.bags.errors import OracleError

QUEUE_BYTES = 64 * 2**20  # of waiting messages, at most
PACKETS_S = 1.0  # between two counts of lost packets, which take a millisecond each


class Received(NamedTuple):
    """A message as received."""

    topic: str
    sent_ns: int  # by the sender's clock [ns since 1970]
    wall_ns: int  # when it arrived, by our clock [ns since 1970]
    steady_ns: int  # the same by our steady clock, which is never set [ns]
    writer: int  # handle of the endpoint that sent it
    data: bytes  # CDR with its encapsulation header


class Intake:
    """Queues the messages of topics; a source subscribes to them, and puts them in.

    Attributes
    ----------
    topics : dict of str to str
        Message type of each subscribed topic.
    """

    def __init__(self) -> None:
        self.topics: dict[str, str] = {}
        self._queue: list[Received] = []
        self._bytes = 0
        self._lost: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._error: OracleError | None = None

    def subscribe(self, topic: str, msgtype: str, *, reliable: bool, latched: bool) -> None:  # noqa: ARG002 -- sources with QoS use them
        """Subscribe to a topic.

        Raises
        ------
        OracleError
            If its type is unknown.
        """
        self.topics[topic] = msgtype

    def accepts(self, topic: str, offered: Qos) -> bool:  # noqa: ARG002 -- sources with QoS use them
        """Return whether a publisher's QoS is compatible with our subscription's."""
        return True

    def take(self) -> list[Received]:
        """Return the queued messages, in order of arrival.

        Raises
        ------
        OracleError
            If messages can no longer be received.
        """
        with self._lock:
            if self._error is not None and not self._queue:
                raise self._error
            taken, self._queue, self._bytes = self._queue, [], 0
        return taken

    def put(self, came: Iterable[Received]) -> None:
        """Queue messages; any thread may call it."""
        with self._lock:
            for received in came:
                if self._bytes + len(received.data) > QUEUE_BYTES:
                    self._lost[received.topic] += 1
                else:
                    self._queue.append(received)
                    self._bytes += len(received.data)

    def count_lost(self, topic: str, messages: int) -> None:
        """Count messages of a topic that were lost on the way; any thread may call it."""
        if messages > 0:
            with self._lock:
                self._lost[topic] += messages

    def lost(self) -> Counter[str]:
        """Return how many messages of each topic were lost since the last call."""
        with self._lock:
            lost, self._lost = self._lost, Counter()
        return lost

    def lost_packets(self) -> int:
        """Return how many packets were lost before they were messages; counted each second."""
        return 0

    def close(self) -> None:
        """Stop receiving; messages that were not taken stay in the queue."""
