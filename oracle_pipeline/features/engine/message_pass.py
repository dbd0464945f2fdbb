"""One pass over the messages of a bag: each is given to the topics that keep something of it."""

import itertools
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.features.engine.kept_topic import KeptTopic
from oracle_pipeline.features.engine.spans import Integers

Bools: TypeAlias = NDArray[np.bool_]

_MOST_WAITING = 16 * 2**20  # bytes of messages that wait to be decoded together


class MessagePass:
    """Hands the messages of a bag on, batch by batch.

    Parameters
    ----------
    topics : list of KeptTopic
        In the order of their numbers in batches.
    start_ns : int
        Start of the recording.
    """

    def __init__(self, topics: list[KeptTopic], start_ns: int) -> None:
        self._topics = topics
        self._start_ns = start_ns
        self._samplers = {
            period_ns: _Sampler(
                period_ns, np.array([period_ns in each.by_period for each in topics], np.bool_)
            )
            for period_ns in sorted({period for topic in topics for period in topic.by_period})
        }
        self._count = 0  # messages so far
        self._waiting = 0  # bytes of messages that wait

    def take(self, batch: Messages) -> None:
        """Keep what is requested of the next messages."""
        in_time = np.argsort(batch.stamps_ns, kind="stable")
        by_topic = in_time[np.argsort(batch.topics[in_time], kind="stable")]
        ordered = batch.topics[by_topic], batch.stamps_ns[by_topic] - self._start_ns
        due: dict[int, list[int]] = {}  # periods by row of messages that are decoded one by one
        for period_ns, sampler in self._samplers.items():
            sampled = by_topic[sampler.due(*ordered)]
            for topic, rows in self._by_topic(batch.topics[sampled], sampled):
                if topic.has(period_ns, "raw"):
                    topic.keep_raw(period_ns, self._count + rows, batch.messages(rows))
                if topic.has(period_ns, "decoded"):
                    for row in rows.tolist():
                        due.setdefault(row, []).append(period_ns)
                if topic.has(period_ns, "many"):
                    self._queue(topic, period_ns, batch, rows)
        for row, periods_ns in due.items():
            topic = self._topics[batch.topics[row]]
            topic.keep_decoded(self._count + row, batch.message(row), periods_ns)
        self._count += len(batch.topics)

    def end(self) -> None:
        """Keep what is requested of the messages that wait."""
        for topic in self._topics:
            topic.keep_waiting()
        self._waiting = 0

    def _queue(self, topic: KeptTopic, period_ns: int, batch: Messages, rows: Integers) -> None:
        for some in _portions(rows, batch.sizes[rows]):
            self._waiting += topic.queue(period_ns, self._count + some, batch.messages(some))
            if self._waiting > _MOST_WAITING:
                self.end()

    def _by_topic(self, numbers: Integers, rows: Integers) -> Iterator[tuple[KeptTopic, Integers]]:
        """Yield each topic with its rows, which are sorted by the number of their topic."""
        if len(rows):
            begins = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(rows)]
            for begin, end in itertools.pairwise(begins):
                yield self._topics[numbers[begin]], rows[begin:end]


def _portions(rows: Integers, sizes: Integers) -> list[Integers]:
    """Split rows where their messages reach multiples of `_MOST_WAITING` bytes."""
    if sizes.sum() <= _MOST_WAITING:
        return [rows]
    return np.split(rows, np.flatnonzero(np.diff(np.cumsum(sizes) // _MOST_WAITING)) + 1)


class _Sampler:
    """Samples the messages of some topics at one rate.

    Parameters
    ----------
    period_ns : int
        Length of the spans [ns]; 0 samples every message.
    is_sampled : ndarray of shape (n_topics,)
        Which topics are sampled.
    """

    def __init__(self, period_ns: int, is_sampled: Bools) -> None:
        self._period_ns = period_ns
        self._is_sampled = is_sampled
        self._last_span = np.full(len(is_sampled), -1)

    def due(self, topics: Integers, since_start_ns: Integers) -> Bools:
        """Return which messages of a batch are sampled; its messages are by topic and time.

        Parameters
        ----------
        topics : ndarray of shape (n,)
            Numbers of the messages' topics.
        since_start_ns : ndarray of shape (n,)
            Stamps of the messages, since the start of the recording.
        """
        return _due(topics, since_start_ns, self._period_ns, self._is_sampled, self._last_span)


@jit
def _due(
    topics: Integers, since_start_ns: Integers, period_ns: int, is_sampled: Bools, last: Integers
) -> Bools:
    """Return which messages are the first in their span; ``last`` are the topics' last spans."""
    is_due = np.zeros(len(topics), np.bool_)
    for i in range(len(topics)):
        topic = topics[i]
        if is_sampled[topic]:
            span = since_start_ns[i] // period_ns if period_ns else 0
            is_due[i] = period_ns == 0 or span != last[topic]
            last[topic] = span
    return is_due
