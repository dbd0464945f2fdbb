"""Topic, time, size and header stamp of every message of a bag."""

from collections.abc import Sequence

import numpy as np

from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.features.engine.message_layout import HeaderStamps, MessageLayout
from oracle_pipeline.features.engine.plugin import TopicArrivals
from oracle_pipeline.features.engine.spans import Integers
from oracle_pipeline.features.engine.timeline import Timeline, epochs, timeline

_NONE: Integers = np.zeros(0, dtype=np.int64)


class MessageIndex:
    """The messages of a bag in file order; `close` determines their times.

    Attributes
    ----------
    times_ns : ndarray of shape (n,)
        Since the start of the recording, without jumps of the clock.
    clock : Timeline
        The recorder's.
    notes : list of str
        On the clock of the recording.
    """

    times_ns: Integers
    clock: Timeline

    def __init__(self, layouts: Sequence[MessageLayout]) -> None:
        self._headers = HeaderStamps(layouts)
        self._topic_count = len(layouts)
        self._topics: list[Integers] = []
        self._stamps_ns: list[Integers] = []
        self._sizes: list[Integers] = []
        self._header_stamps_ns: list[Integers] = []
        self.notes: list[str] = []

    def __len__(self) -> int:
        return len(self.times_ns)

    def add(self, batch: Messages) -> None:
        """Add the next messages."""
        self._topics.append(batch.topics)
        self._stamps_ns.append(batch.stamps_ns)
        self._sizes.append(batch.sizes)
        self._header_stamps_ns.append(self._headers.of_batch(batch))

    def close(self, bag: BagReader, *, jumps: bool) -> None:
        """Determine the times of all messages.

        Parameters
        ----------
        bag : BagReader
            Has the start and the end of the recording.
        jumps : bool
            Whether long silences count as jumps of the clock.
        """
        topics = _joined(self._topics).astype(np.int16)
        by_topic = np.argsort(topics, kind="stable")  # in file order
        bounds = np.searchsorted(topics[by_topic], np.arange(1, self._topic_count))
        ordered_ns = _joined(self._stamps_ns)[by_topic]
        split_ns = np.split(ordered_ns, bounds) if self._topic_count else []
        if jumps:
            epoch = epochs(split_ns)
            clock = timeline(split_ns, epoch, bag.start_ns, bag.end_ns)
        else:
            epoch, clock = [], Timeline((0,), (bag.start_ns,), (bag.end_ns,))
        self.clock = clock
        self.times_ns = np.empty(len(topics), dtype=np.int64)
        self.times_ns[by_topic] = clock.times_ns(ordered_ns, epoch)
        self._rows = np.split(by_topic, bounds) if self._topic_count else []
        if note := clock.note():
            self.notes.append(note)
        if len(topics) > 1 and clock.duration_ns == 1:
            self.notes.append(
                f"All {len(topics)} messages were recorded at the same time: the recorder's clock "
                "stood still, as simulated time does without /clock."
            )
        del split_ns, epoch, ordered_ns  # a copy for millions of messages takes much memory
        self._size, self._header_stamp_ns = _joined(self._sizes), _joined(self._header_stamps_ns)

    def arrivals(self, topic: int, msgtype: str) -> tuple[Integers, TopicArrivals]:
        """Return the times of a topic's messages [ns], and the same for plugins."""
        rows = self._rows[topic]
        times_ns = self.times_ns[rows]
        if (times_ns[1:] < times_ns[:-1]).any():  # seldom; sorting takes time and memory
            order = np.argsort(times_ns, kind="stable")
            rows, times_ns = rows[order], times_ns[order]
        stamps_ns = self._header_stamp_ns[rows]
        if (stamps_ns == HeaderStamps.NONE).any():
            stamps_ns = _NONE.copy()
        columns = times_ns / 1e9, self._size[rows], stamps_ns
        for column in columns:
            column.flags.writeable = False
        return times_ns, TopicArrivals(msgtype, *columns)


def _joined(parts: list[Integers]) -> Integers:
    """Concatenate arrays, and clear the list."""
    whole = np.concatenate([_NONE, *parts])
    parts.clear()
    return whole
