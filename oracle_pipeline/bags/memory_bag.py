"""A bag in memory: messages that no file holds, with the interface of a recording."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.definitions import BagTypes
from oracle_pipeline.bags.merging import Messages, in_time_order
from oracle_pipeline.bags.part import Channel
from oracle_pipeline.bags.reader import BagReader, RawMessage, Topic


class MemoryBag(BagReader):
    """Messages in memory, such as the last seconds of a recording in progress.

    Parameters
    ----------
    path : Path
        Name of the recording in messages for people; no file is opened.
    topics : mapping of str to Topic
        The topics of the recording, of types that this project knows. Their counts are replaced.
    messages : sequence of RawMessage
        On these topics.
    start_ns, end_ns : int
        Stamps at which the recording begins and ends [ns].
    """

    def __init__(
        self,
        path: Path,
        topics: Mapping[str, Topic],
        messages: Sequence[RawMessage],
        start_ns: int,
        end_ns: int,
    ) -> None:
        self.path = path
        self.notes, self.losses = [], []
        counts = Counter(message.topic for message in messages)
        self.topics = {name: replace(topic, count=counts[name]) for name, topic in topics.items()}
        self.message_count = len(messages)
        self.start_ns, self.end_ns = start_ns, end_ns
        self.serialization = "cdr"
        channels = [Channel(t.name, t.msgtype, "cdr", "", "", "", "") for t in topics.values()]
        self._types = BagTypes(path, channels, {})
        self._messages = messages
        self._shown = {name: name for name in self.topics}

    def batches(self, topics: Collection[str] | None = None) -> Iterator[Messages]:
        """Yield all messages of some topics at once."""
        place = {name: number for number, name in enumerate(self.topics)}
        numbers = {
            name: place[shown]
            for name, shown in self._shown.items()
            if topics is None or shown in topics
        }
        wanted = [message for message in self._messages if message.topic in numbers]
        sizes = np.array([len(message.data) for message in wanted], dtype=np.int64)
        yield Messages(
            b"".join([message.data for message in wanted]),
            np.array([numbers[message.topic] for message in wanted], dtype=np.int64),
            np.array([message.stamp_ns for message in wanted], dtype=np.int64),
            np.cumsum(sizes) - sizes,
            sizes,
        )

    def in_order(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[Messages, NDArray[np.int64]]]:
        """Yield messages in order of time as arrays, and rows in that order."""
        return in_time_order(lambda: self.batches(topics), is_in_order=True)

    def close(self) -> None:
        """Do nothing: no file is open."""
