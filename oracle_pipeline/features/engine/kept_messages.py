"""Reads a bag once for all plugins; what they keep of its messages is stored in arrays.

Each message is decoded at most once, and only if a plugin requested it. Windows are slices of the
arrays.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.features.engine.kept_rows import (
    Budget,
    Carried,
    Integers,
    KeptRows,
    Span,
    read_only,
)
from oracle_pipeline.features.engine.kept_topic import KeptTopic
from oracle_pipeline.features.engine.message_layout import (
    SHORTEST_WITH_HEADER,
    MessageLayout,
    header_stamps_ns,
)
from oracle_pipeline.features.engine.plugin import (
    Arrivals,
    FeaturePlugin,
    Missing,
    Series,
    Window,
)
from oracle_pipeline.features.engine.timeline import Timeline, epochs, timeline
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.robots.robot import Robot, find_robots

Bools: TypeAlias = NDArray[np.bool_]

_MOST_WAITING = 16 * 2**20  # bytes of messages that wait to be decoded together
_NONE: Integers = np.zeros(0, dtype=np.int64)
_NO_STAMP = np.iinfo(np.int64).min  # of a message without a header


class _Sampling:
    """Samples messages at one rate: the first of each topic in each span of that length."""

    def __init__(self, rate_ns: int, topics: list[KeptTopic]) -> None:
        self._rate_ns = rate_ns
        self._asks = np.array([rate_ns in topic.by_rate for topic in topics], dtype=np.bool_)
        self._last = np.full(len(topics), -1)

    def due(self, topics: Integers, since_start_ns: Integers) -> Bools:
        """Return which messages of a batch are sampled; its messages are by topic and time.

        Parameters
        ----------
        topics : ndarray of shape (n,)
            Numbers of the messages' topics.
        since_start_ns : ndarray of shape (n,)
            Stamps of the messages, since the start of the recording.
        """
        return _sampled(topics, since_start_ns, self._rate_ns, self._asks, self._last)


@jit
def _sampled(
    topics: Integers, since_start_ns: Integers, rate_ns: int, asks: Bools, last: Integers
) -> Bools:
    """Return which messages are the first in their span; ``last`` are the topics' last spans."""
    is_due = np.zeros(len(topics), np.bool_)
    for i in range(len(topics)):
        topic = topics[i]
        if asks[topic]:
            span = since_start_ns[i] // rate_ns if rate_ns else 0
            is_due[i] = rate_ns == 0 or span != last[topic]
            last[topic] = span
    return is_due


class _Headers:
    """Reads the stamps in the headers of messages."""

    def __init__(self, topics: list[KeptTopic]) -> None:
        self._of: dict[bool, Bools] = {}  # which topics have headers in an encoding
        for topic in topics:
            if topic.layout.has_header:
                of = self._of.setdefault(topic.layout.is_cdr, np.zeros(len(topics), dtype=np.bool_))
                of[topics.index(topic)] = True

    def stamps_ns(self, batch: Messages) -> Integers:
        """Return the stamp of each message of a batch [ns]."""
        stamps_ns = np.full(len(batch.topics), _NO_STAMP)
        for is_cdr, of in self._of.items():
            rows = np.flatnonzero(of[batch.topics] & (batch.sizes >= SHORTEST_WITH_HEADER))
            stamps_ns[rows] = header_stamps_ns(batch.data, batch.offsets[rows], is_cdr=is_cdr)
        return stamps_ns


class _Cut(Mapping[str, Mapping[str, Series]]):
    """What was kept within a span, by key of the request; cut on access, as few plugins use it."""

    def __init__(
        self, requests: Mapping[str, Mapping[str, KeptRows]], span: Span, *, silent: bool
    ) -> None:
        self._requests = requests
        self._span = span
        self._silent = silent  # topics without a row are there, too

    def __getitem__(self, key: str) -> Mapping[str, Series]:
        cut = {name: kept.within(self._span) for name, kept in self._requests[key].items()}
        if self._silent:
            return cut
        return {name: series for name, series in cut.items() if len(series.times_s)}

    def __iter__(self) -> Iterator[str]:
        return iter(self._requests)

    def __len__(self) -> int:
        return len(self._requests)


def decoded_topics(bag: BagReader, plugins: Iterable[FeaturePlugin]) -> frozenset[str]:
    """Return the topics of a bag whose decoded messages are requested by any plugin."""
    requests = [r for plugin in plugins for r in plugin.topics.values() if not r.raw]
    return frozenset(
        robot.bag.recorded(name)
        for robot in find_robots(bag)
        for name, topic in robot.bag.topics.items()
        if any(r.matches(topic, MessageLayout(robot.bag, name), robot.roles) for r in requests)
    )


class Graphs(NamedTuple):
    """The ROS graphs of a span, the same for every plugin."""

    graph: RosGraph | None
    system: RosGraph | None
    intervals: tuple[Interval, ...]


NO_GRAPH = Graphs(None, None, ())


class KeptMessages:
    """The times of the messages of a bag, and the values that plugins keep of them.

    Attributes
    ----------
    duration_ns : int
        From the first message to a nanosecond after the last, without jumps of the clock.
    notes : list of str
        The messages that were not used, with the reasons.
    shared : dict
        Results that the plugins share, ``Window.shared``.
    """

    def __init__(self, robot: Robot, plugins: tuple[FeaturePlugin, ...]) -> None:
        bag = robot.bag
        self._roles = robot.roles
        self.shared: dict[Any, Any] = {}
        self._budget = budget = Budget()
        self.notes: list[str] = []
        self._topics = {name: KeptTopic(bag, topic) for name, topic in bag.topics.items()}
        self._kept: dict[str, dict[str, dict[str, KeptRows]]] = {
            plugin.name: {
                key: {
                    name: self._topics[name].ask(request, budget)
                    for name in sorted(self._topics)
                    if request.matches(bag.topics[name], self._topics[name].layout, robot.roles)
                }
                for key, request in plugin.topics.items()
            }
            for plugin in plugins
        }

    @classmethod
    def read(
        cls,
        robot: Robot,
        plugins: tuple[FeaturePlugin, ...],
        carried: Carried | None = None,
        see: Callable[[Messages], None] | None = None,
    ) -> Self:
        """Read the messages of a robot for some plugins.

        Parameters
        ----------
        robot : Robot
        plugins : tuple of FeaturePlugin
        carried : mapping, optional
            For a bag with only the end of a recording: the earlier result of `carried`. Gaps then
            do not count as jumps of the clock.
        see : callable, optional
            Is given the messages too, batch by batch.
        """
        bag = robot.bag
        recording = cls(robot, plugins)
        topics = list(recording._topics.values())
        rates_ns = sorted({rate_ns for topic in topics for rate_ns in topic.by_rate})
        samplings = {rate_ns: _Sampling(rate_ns, topics) for rate_ns in rates_ns}
        headers = _Headers(topics)
        columns: list[list[Integers]] = [[], [], [], []]
        count = waiting = 0
        for batch in bag.batches():
            if see is not None:
                see(batch)
            recording._budget.count(len(batch.topics))
            in_time = np.argsort(batch.stamps_ns, kind="stable")
            by_topic = in_time[np.argsort(batch.topics[in_time], kind="stable")]
            ordered = batch.topics[by_topic], batch.stamps_ns[by_topic] - bag.start_ns
            due: dict[int, list[int]] = {}
            for rate_ns, sampling in samplings.items():
                sampled = by_topic[sampling.due(*ordered)]
                for topic, rows in _by_topic(topics, batch.topics, sampled):
                    if topic.has(rate_ns, "raw"):
                        topic.keep_raw(rate_ns, count + rows, batch.messages(rows))
                    if topic.has(rate_ns, "decoded"):
                        for row in rows.tolist():
                            due.setdefault(row, []).append(rate_ns)
                    if topic.has(rate_ns, "many"):
                        for some in _portions(rows, batch.sizes[rows]):
                            waiting += topic.wait(rate_ns, count + some, batch.messages(some))
                            if waiting > _MOST_WAITING:
                                for each in topics:
                                    each.keep_waiting()
                                waiting = 0
            for row, rates in due.items():
                topics[batch.topics[row]].keep(count + row, batch.message(row), rates)
            of_batch = batch.topics, batch.stamps_ns, batch.sizes, headers.stamps_ns(batch)
            for column, values in zip(columns, of_batch, strict=True):
                column.append(values)
            count += len(batch.topics)
        for topic in topics:
            topic.keep_waiting()
        recording._finish(bag, carried, *columns)
        return recording

    def carried(self) -> Carried:
        """Return the rows that later windows need after their messages are dropped."""
        return {
            (topic.name, key): kept.last()
            for topic in self._topics.values()
            for key, kept in topic.kept.items()
            if kept.request.carried and not kept.error
        }

    def occupied(self) -> Integers:
        """Return the sorted times of all messages since the start [ns]."""
        return np.sort(self._times_ns)

    def _finish(
        self,
        bag: BagReader,
        carried: Carried | None,
        numbers: list[Integers],
        stamps_ns: list[Integers],
        all_sizes: list[Integers],
        all_headers: list[Integers],
    ) -> None:
        """Join the parts into arrays, which empties them; note what was not used."""
        topics = list(self._topics.values())
        of = _joined(numbers).astype(np.int16)
        by_topic = np.argsort(of, kind="stable")  # in file order
        bounds = np.searchsorted(of[by_topic], np.arange(1, len(topics)))
        ordered_ns = _joined(stamps_ns)[by_topic]
        split = np.split(ordered_ns, bounds) if topics else []
        if carried is None:
            epoch_of = epochs(split)
            clock = timeline(split, epoch_of, bag.start_ns, bag.end_ns)
        else:
            epoch_of, clock = [], Timeline((0,), (bag.start_ns,), (bag.end_ns,))
        self.duration_ns = clock.duration_ns
        if note := clock.note():
            self.notes.append(note)
        if len(of) > 1 and self.duration_ns == 1:
            self.notes.append(
                f"All {len(of)} messages were recorded at the same time: the recorder's clock "
                "stood still, as simulated time does without /clock."
            )
        times_ns = np.empty(len(of), dtype=np.int64)
        times_ns[by_topic] = clock.times_ns(ordered_ns, epoch_of)
        self._times_ns = times_ns
        del split, epoch_of, ordered_ns
        sizes, headers = _joined(all_sizes), _joined(all_headers)
        self._arrivals: dict[str, tuple[Integers, Arrivals]] = {}
        undecoded: dict[str, dict[str, int]] = {}  # by reason: topics, and their messages
        for topic, rows in zip(topics, np.split(by_topic, bounds) if topics else [], strict=True):
            rows = rows[np.argsort(times_ns[rows], kind="stable")]
            own_ns, own_headers = times_ns[rows], headers[rows]
            if (own_headers == _NO_STAMP).any():
                own_headers = _NONE.copy()
            self._arrivals[topic.name] = own_ns, Arrivals(
                topic.msgtype, read_only(own_ns / 1e9), read_only(sizes[rows]),
                read_only(own_headers),
            )  # fmt: skip
            known = carried or {}
            notes = {
                kept.finish(times_ns, known.get((topic.name, key)))
                for key, kept in topic.kept.items()
            }
            if not topic.undecodable:
                self.notes += sorted(f"{topic.name}: {note.rstrip('.')}." for note in notes if note)
            elif len(rows):
                undecoded.setdefault(topic.undecodable, {})[topic.name] = len(rows)
        for reason, messages in undecoded.items():
            share = sum(messages.values()) / len(of)
            self.notes.append(
                f"Only the times and sizes of {', '.join(messages)} are used ({share:.0%} of the "
                f"messages): {reason}"
            )

    def span(self, span: Span, graphs: Graphs) -> Window:
        """Return the part of a span's window that is the same for every plugin."""
        arrivals = {name: self._within(name, span) for name in sorted(self._topics)}
        return Window(
            span.start_s, span.end_s, *graphs, arrivals, roles=self._roles,
            shared=self.shared,
        )  # fmt: skip

    def _within(self, topic: str, span: Span) -> Arrivals:
        times_ns, arrivals = self._arrivals[topic]
        part = span.of(times_ns)
        _, times_s, sizes, stamps_ns = arrivals
        return Arrivals(arrivals.msgtype, times_s[part], sizes[part], stamps_ns[part])

    def window(
        self, plugin: FeaturePlugin, span: Span, common: Window, prepared: Any = None
    ) -> Window | Missing:
        """Return the window of a span for one plugin, or the reason why it has none."""
        requests = self._kept[plugin.name]
        if plugin.needs_graph and common.graph is None:
            return Missing("no ROS graph was recorded before the end of the window")
        for key, request in plugin.topics.items():
            for name, kept in requests[key].items():
                if kept.error:
                    return Missing(f"{name} cannot be used: {kept.error}")
            if not request.optional and not requests[key]:
                return Missing(f"no topic {request} is recorded")
        topics = _Cut(requests, span, silent=False)
        for key, request in plugin.topics.items():
            if not request.optional and not topics[key]:
                return Missing(f"no message on {', '.join(requests[key])} in this window")
        history = _Cut(requests, Span(0, span.end_ns), silent=True)
        return Window(
            common.start_s, common.end_s, common.graph, common.system, common.intervals,
            common.arrivals, topics, history, prepared, common.roles, common.shared,
        )  # fmt: skip


def _by_topic(
    topics: list[KeptTopic], numbers: Integers, rows: Integers
) -> Iterator[tuple[KeptTopic, Integers]]:
    """Yield each topic with its rows; the rows are sorted by topic."""
    if len(rows):
        of = numbers[rows]
        begins = [0, *(np.flatnonzero(of[1:] != of[:-1]) + 1).tolist(), len(rows)]
        for begin, end in itertools.pairwise(begins):
            yield topics[of[begin]], rows[begin:end]


def _portions(rows: Integers, sizes: Integers) -> list[Integers]:
    """Split rows where their messages reach multiples of `_MOST_WAITING` bytes."""
    if sizes.sum() <= _MOST_WAITING:
        return [rows]
    return np.split(rows, np.flatnonzero(np.diff(np.cumsum(sizes) // _MOST_WAITING)) + 1)


def _joined(parts: list[Integers]) -> Integers:
    """Concatenate arrays, and clear the list: a copy for millions of messages takes much memory."""
    whole = np.concatenate([_NONE, *parts])
    parts.clear()
    return whole
