"""The last seconds of a recording in progress, as a bag in memory.

The last message of a latched topic is kept however old it is, as for a late subscriber, because
maps and static transforms are sent once.
"""

from collections import deque
from pathlib import Path

from rosbags.interfaces import Qos

from oracle_pipeline.bags.memory_bag import MemoryBag
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.qos_profiles import is_latched
from oracle_pipeline.bags.reader import RawMessage, Topic
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.opened_run import OpenedRun

CONTEXT_S = 12.5  # of messages in memory: features use messages from before their window
_LATCHED = 20  # latest messages of a latched topic in memory
_SECOND_NS = 1_000_000_000
_PATH = Path("live")  # there is no file


class RecentMessages:
    """Keeps the messages that windows of a recording in progress need.

    Parameters
    ----------
    context_s : float
        How long messages stay in memory [s of the recording].
    """

    def __init__(self, context_s: float = CONTEXT_S) -> None:
        self._context_ns = round(context_s * _SECOND_NS)
        self._topics: dict[str, Topic] = {}
        self._messages: deque[RawMessage] = deque()
        self._latched: dict[str, deque[RawMessage]] = {}
        self._graphs: deque[Interval] = deque(maxlen=round(context_s / INTERVAL_S) + 1)

    def add_topic(self, name: str, msgtype: str, qos: tuple[Qos, ...]) -> None:
        """Announce a topic, or more publishers of it."""
        known = self._topics.get(name)
        profiles = (*known.qos, *qos) if known else qos
        self._topics[name] = Topic(name, msgtype, 0, profiles)
        if all(is_latched(profile) for profile in profiles):
            self._latched.setdefault(name, deque(maxlen=_LATCHED))
        else:
            self._latched.pop(name, None)

    def add(self, messages: list[RawMessage]) -> None:
        """Add messages in order of time; old ones are dropped."""
        self._messages.extend(messages)
        for message in messages:
            if message.topic in self._latched:
                self._latched[message.topic].append(message)
        if messages:
            self._drop(messages[-1].stamp_ns - self._context_ns)

    def clear(self) -> None:
        """Drop all messages and graphs; topics stay."""
        self._messages.clear()
        self._graphs.clear()
        for kept in self._latched.values():
            kept.clear()

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
        bag = MemoryBag(_PATH, self._topics, latched + recent, start_ns, end_ns - 1)
        return OpenedRun(_PATH, bag, None, tuple(self._graphs))

    def _drop(self, before_ns: int) -> None:
        messages = self._messages
        while messages and messages[0].stamp_ns < before_ns:
            messages.popleft()
