"""The last seconds of a recording in progress, as a bag in memory.

The last message of a latched topic is kept however old it is, as for a late subscriber, because
maps and static transforms are sent once.
"""

from collections import Counter, deque
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.interfaces import Qos

from oracle_pipeline.bags.definitions import BagTypes
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.part import Channel
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.qos_profiles import is_latched
from oracle_pipeline.bags.reader import BagReader, Topic
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.opened_run import OpenedRun

CONTEXT_S = 12.5  # of messages in memory: features use messages from before their window
_LATCHED = 20  # latest messages of a latched topic in memory
_SECOND_NS = 1_000_000_000


class Stamped(NamedTuple):
    """A message and its stamp in the recording."""

    topic: str
    stamp_ns: int
    data: bytes


class _MemoryBag(BagReader):
    """Messages in memory with the interface of a bag, in order of time."""

    def __init__(
        self,
        topics: dict[str, tuple[str, tuple[Qos, ...]]],
        messages: list[Stamped],
        start_ns: int,
        end_ns: int,
    ) -> None:
        self.path = Path("live")
        self.notes, self.losses = [], []
        counts = Counter(message.topic for message in messages)
        self.topics = {
            name: Topic(name, msgtype, counts[name], qos) for name, (msgtype, qos) in topics.items()
        }
        self.message_count = len(messages)
        self.start_ns, self.end_ns = start_ns, end_ns
        self.serialization = "cdr"
        channels = [Channel(t.name, t.msgtype, "cdr", "", "", "", "") for t in self.topics.values()]
        self._types = BagTypes(self.path, channels, {})
        self._messages = messages
        self._shown = {name: name for name in self.topics}

    def batches(self, topics: Collection[str] | None = None) -> Iterator[Messages]:
        """Yield all messages of some topics at once."""
        numbers = {name: number for number, name in enumerate(self.topics)}
        wanted = [
            (numbers[shown], message)
            for message in self._messages
            if (shown := self._shown.get(message.topic)) and (topics is None or shown in topics)
        ]
        sizes = np.array([len(message.data) for _, message in wanted], dtype=np.int64)
        yield Messages(
            b"".join(message.data for _, message in wanted),
            np.array([number for number, _ in wanted], dtype=np.int64),
            np.array([message.stamp_ns for _, message in wanted], dtype=np.int64),
            np.cumsum(sizes) - sizes,
            sizes,
        )

    def close(self) -> None:
        """Do nothing: no file is open."""


class RecentMessages:
    """Keeps the messages that windows of a recording in progress need.

    Parameters
    ----------
    context_s : float
        How long messages stay in memory [s of the recording].
    """

    def __init__(self, context_s: float = CONTEXT_S) -> None:
        self._context_ns = round(context_s * _SECOND_NS)
        self._topics: dict[str, tuple[str, tuple[Qos, ...]]] = {}
        self._messages: deque[Stamped] = deque()
        self._latched: dict[str, deque[Stamped]] = {}
        self._graphs: deque[Interval] = deque(maxlen=round(context_s / INTERVAL_S) + 1)

    def add_topic(self, name: str, msgtype: str, qos: tuple[Qos, ...]) -> None:
        """Announce a topic, or more publishers of it."""
        known = self._topics.get(name, (msgtype, ()))[1]
        self._topics[name] = msgtype, known + qos
        if all(is_latched(profile) for profile in self._topics[name][1]):
            self._latched.setdefault(name, deque(maxlen=_LATCHED))
        else:
            self._latched.pop(name, None)

    def add(self, messages: list[Stamped]) -> None:
        """Add messages in order of time; old ones are dropped."""
        self._messages.extend(messages)
        for message in messages:
            if message.topic in self._latched:
                self._latched[message.topic].append(message)
        if messages:
            self._drop(messages[-1].stamp_ns - self._context_ns)

    def add_graph(self, interval: Interval) -> None:
        """Add the graph of an interval; its start is in seconds of the recording."""
        self._graphs.append(interval)

    def until(self, start_ns: int, end_ns: int) -> OpenedRun:
        """Return the messages before a time, as a recording.

        Parameters
        ----------
        start_ns : int
            Stamp at which the whole recording began.
        end_ns : int
            Stamp at which the returned recording ends.
        """
        begin_ns = max(start_ns, end_ns - self._context_ns)
        recent = [m for m in self._messages if begin_ns <= m.stamp_ns < end_ns]
        latched = [
            message
            for kept in self._latched.values()
            for message in kept
            if message.stamp_ns < begin_ns
        ]
        bag = _MemoryBag(self._topics, latched + recent, start_ns, end_ns - 1)
        return OpenedRun(Path("live"), bag, None, tuple(self._graphs))

    def _drop(self, before_ns: int) -> None:
        messages = self._messages
        while messages and messages[0].stamp_ns < before_ns:
            messages.popleft()
