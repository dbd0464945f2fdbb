"""One pass over a bag for all plugins: what they keep of its messages, as arrays.

Each message is decoded at most once, and only if a plugin asked for it. Windows are slices of the
arrays.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Self

import networkx as nx
import numpy as np

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.limits import LARGEST_DECODED
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.reader import BagReader, Topic
from oracle_pipeline.features.columns import Batch
from oracle_pipeline.features.kept_rows import Budget, Integers, KeptRows, Span, read_only
from oracle_pipeline.features.message_layout import (
    SHORTEST_WITH_HEADER,
    MessageLayout,
    header_stamps_ns,
)
from oracle_pipeline.features.plugin import (
    Arrivals,
    FeaturePlugin,
    Missing,
    RawRecord,
    Request,
    Series,
    Window,
)
from oracle_pipeline.features.point_clouds import CutClouds, sliced
from oracle_pipeline.features.timeline import epochs, timeline
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.graphs.views import system_view
from oracle_pipeline.robots.robot import Robot, find_robots
from oracle_pipeline.robots.roles import POINT_CLOUD, SCAN

# Bytes of messages that are kept together with later ones: of all topics, and of one.
_MOST_WAITING, _MOST_WAITING_OF_TOPIC = 16 * 2**20, 2**22
_NONE: Integers = np.zeros(0, dtype=np.int64)
_NO_STAMP = np.iinfo(np.int64).min  # of a message without a header


class _Topic:
    """One topic of the bag, and who keeps what of its messages."""

    def __init__(self, bag: BagReader, topic: Topic) -> None:
        self.name, self.msgtype = topic.name, topic.msgtype
        self.layout = MessageLayout(bag, topic.name)
        self.kept: dict[Any, KeptRows] = {}  # by what makes two requests the same
        self.by_rate: dict[int, list[KeptRows]] = {}  # by time between messages [ns]
        self.undecodable = ""
        self._waiting: dict[int, list[tuple[int, bytes]]] = {}  # number and message, by rate
        self._held = 0  # bytes of them
        try:
            self._decode = bag.decoder(topic.name)
            self._store = bag.typestore(topic.msgtype)
        except BagError as error:
            self.undecodable = str(error)

    def ask(self, request: Request, budget: Budget) -> KeptRows:
        """Return what keeps the rows of a request, one for all equal requests."""
        as_scan = request.role == SCAN and self.msgtype == POINT_CLOUD
        key = request.keep, np.dtype(request.dtype), request.raw, request.every_s, as_scan
        if key not in self.kept:
            self.kept[key] = kept = KeptRows(request, budget)
            kept.as_scan = as_scan
            self.by_rate.setdefault(round(request.every_s * 1e9), []).append(kept)
            if self.undecodable and not request.raw:
                kept.fail(self.undecodable)
        return self.kept[key]

    def has(self, rate_ns: int, *, many: bool) -> bool:
        """Tell whether messages are asked for at a rate, one by one or many together."""
        return any(
            kept.request.many == many and not kept.error for kept in self.by_rate.get(rate_ns, ())
        )

    def keep(self, number: int, data: bytes, rates_ns: list[int]) -> None:
        """Keep what is wanted, by itself, of a message that is due at some rates."""
        record = RawRecord(data, self.layout)
        content: Any = None
        scan: Any = None
        for rate_ns in rates_ns:
            for kept in self.by_rate[rate_ns]:
                if kept.error or kept.request.many:
                    continue
                if kept.request.raw:
                    kept.add(number, record, len(data))
                    continue
                try:
                    content = content or self._decoded(data)
                    if kept.as_scan:
                        scan = scan or sliced(content)
                except BagError as error:
                    kept.skip(str(error))
                else:
                    kept.add(number, scan if kept.as_scan else content, len(data))

    def wait(self, rate_ns: int, number: int, data: bytes) -> int:
        """Take a message that is kept together with others; return how many bytes it holds."""
        if len(data) > LARGEST_DECODED:
            for kept in self.by_rate[rate_ns]:
                if kept.request.many:
                    kept.skip(_too_large(data))
            return 0
        self._waiting.setdefault(rate_ns, []).append((number, data))
        self._held += len(data)
        if self._held > _MOST_WAITING_OF_TOPIC:
            self.keep_waiting()
        return len(data)

    def keep_waiting(self) -> None:
        """Keep what is wanted of the messages that were taken."""
        for rate_ns, messages in self._waiting.items():
            many = [kept for kept in self.by_rate[rate_ns] if kept.request.many]
            numbers = np.array([number for number, _ in messages], dtype=np.int64)
            batch = Batch(
                [data for _, data in messages], self._store, self.msgtype, is_cdr=self.layout.is_cdr
            )
            whole = batch.whole
            if not whole.all():
                self._keep_odd(numbers[~whole], batch.some(np.flatnonzero(~whole)), many)
                numbers, batch = numbers[whole], batch.some(np.flatnonzero(whole))
            self._add(numbers, batch, many)
        self._waiting.clear()
        self._held = 0

    def _keep_odd(self, numbers: Integers, batch: Batch, many: list[KeptRows]) -> None:
        """Keep messages that are broken, or written in another way; decoding tells which."""
        written, good = [], []
        for number, data in zip(numbers.tolist(), batch.data, strict=True):
            try:
                content = self._decoded(data)
                written.append(bytes(self._store.serialize_cdr(content, self.msgtype)))
                good.append(number)
            except Exception as error:  # of a generated encoder, too
                for kept in many:
                    kept.skip(str(error))
        again = Batch(written, self._store, self.msgtype, is_cdr=True)
        self._add(np.array(good, dtype=np.int64), again, many)

    def _add(self, numbers: Integers, batch: Batch, many: list[KeptRows]) -> None:
        scans = CutClouds(batch, self._decoded)
        for kept in many:
            kept.add_many(numbers, scans if kept.as_scan else batch)

    def _decoded(self, data: bytes) -> Any:
        if len(data) > LARGEST_DECODED:
            raise BagError(_too_large(data))
        return self._decode(data)


class _Sampling:
    """Which messages are due at one rate: of each topic the first in each span of its length."""

    def __init__(self, rate_ns: int, topics: list[_Topic]) -> None:
        self._rate_ns = rate_ns
        self._asks = np.array([rate_ns in topic.by_rate for topic in topics], dtype=np.bool_)
        self._last = np.full(len(topics), -1)

    def due(self, topics: Integers, since_start_ns: Integers) -> Integers:
        """Return which of messages, by topic and in order of time, are due."""
        rows = np.flatnonzero(self._asks[topics])
        if not self._rate_ns or not len(rows):
            return rows
        topics, slots = topics[rows], since_start_ns[rows] // self._rate_ns
        begins = np.diff(topics, prepend=-1) != 0
        is_due = (np.diff(slots, prepend=-1) != 0) | begins
        is_due[begins] = slots[begins] != self._last[topics[begins]]
        ends = np.roll(begins, -1)
        self._last[topics[ends]] = slots[ends]
        due: Integers = rows[is_due]
        return due


class _Headers:
    """Reads the stamps in the headers of messages."""

    def __init__(self, topics: list[_Topic]) -> None:
        self._has = np.array([topic.layout.has_header for topic in topics], dtype=np.bool_)

    def stamps_ns(self, batch: Messages, topics: list[_Topic]) -> Integers:
        """Return the stamp of each message of a batch [ns]."""
        stamps_ns = np.full(len(batch.topics), _NO_STAMP)
        rows = np.flatnonzero(self._has[batch.topics] & (batch.sizes >= SHORTEST_WITH_HEADER))
        encodings = {topics[number].layout.is_cdr for number in np.unique(batch.topics[rows])}
        for is_cdr in sorted(encodings):
            of = np.array([topic.layout.is_cdr == is_cdr for topic in topics], dtype=np.bool_)
            some = rows[of[batch.topics[rows]]] if len(encodings) > 1 else rows
            stamps_ns[some] = header_stamps_ns(batch.data, batch.offsets[some], is_cdr=is_cdr)
        return stamps_ns


def decoded_topics(bag: BagReader, plugins: Iterable[FeaturePlugin]) -> frozenset[str]:
    """Return the topics of a bag whose messages some plugins want decoded."""
    requests = [r for plugin in plugins for r in plugin.topics.values() if not r.raw]
    return frozenset(
        robot.bag.recorded(name)
        for robot in find_robots(bag)
        for name, topic in robot.bag.topics.items()
        if any(r.matches(topic, MessageLayout(robot.bag, name), robot.roles) for r in requests)
    )


class KeptMessages:
    """When the messages of a bag came, and what plugins kept of them.

    Attributes
    ----------
    duration_ns : int
        From the first message to a nanosecond after the last, jumps of the clock left out.
    notes : list of str
        What was not used, and why.
    """

    def __init__(self, robot: Robot, plugins: tuple[FeaturePlugin, ...]) -> None:
        bag = robot.bag
        self._roles = robot.roles
        self._shared: dict[Any, Any] = {}
        self._budget = budget = Budget()
        self.notes: list[str] = []
        self._topics = {name: _Topic(bag, topic) for name, topic in bag.topics.items()}
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
    def read(cls, robot: Robot, plugins: tuple[FeaturePlugin, ...]) -> Self:
        """Read what a robot sees of a bag, for some plugins."""
        bag = robot.bag
        recording = cls(robot, plugins)
        topics = list(recording._topics.values())
        rates_ns = sorted({rate_ns for topic in topics for rate_ns in topic.by_rate})
        samplings = {rate_ns: _Sampling(rate_ns, topics) for rate_ns in rates_ns}
        headers = _Headers(topics)
        columns: list[list[Integers]] = [[], [], [], []]
        count = waiting = 0
        for batch in bag.batches():
            recording._budget.count(len(batch.topics))
            stamps_ns = batch.stamps_ns
            order = np.lexsort((stamps_ns, batch.topics))
            ordered, since_start_ns = batch.topics[order], stamps_ns[order] - bag.start_ns
            due: dict[int, list[int]] = {}
            for rate_ns, sampling in samplings.items():
                rows = order[sampling.due(ordered, since_start_ns)]
                for topic, some in _by_topic(topics, batch.topics, rows):
                    if topic.has(rate_ns, many=False):
                        for row in some:
                            due.setdefault(row, []).append(rate_ns)
                    if topic.has(rate_ns, many=True):
                        for row in some:
                            waiting += topic.wait(rate_ns, count + row, batch.message(row))
                            if waiting > _MOST_WAITING:
                                for each in topics:
                                    each.keep_waiting()
                                waiting = 0
            for row, rates in due.items():
                topics[batch.topics[row]].keep(count + row, batch.message(row), rates)
            header_stamps_ns = headers.stamps_ns(batch, topics)
            for column, values in zip(
                columns, (batch.topics, stamps_ns, batch.sizes, header_stamps_ns), strict=True
            ):
                column.append(values)
            count += len(stamps_ns)
        for topic in topics:
            topic.keep_waiting()
        recording._finish(bag, *columns)
        return recording

    def occupied(self) -> Integers:
        """Return when messages came, in order of time, since the start [ns]."""
        return np.sort(self._times_ns)

    def _finish(
        self,
        bag: BagReader,
        numbers: list[Integers],
        stamps_ns: list[Integers],
        all_sizes: list[Integers],
        all_headers: list[Integers],
    ) -> None:
        """Make arrays of what was read in parts, which are let go of; say what was not used."""
        topics = list(self._topics.values())
        of = _joined(numbers).astype(np.int16)
        by_topic = np.argsort(of, kind="stable")  # in file order
        bounds = np.searchsorted(of[by_topic], np.arange(1, len(topics)))
        ordered_ns = _joined(stamps_ns)[by_topic]
        split = np.split(ordered_ns, bounds) if topics else []
        epoch_of = epochs(split)
        clock = timeline(split, epoch_of, bag.start_ns, bag.end_ns)
        self.duration_ns = clock.duration_ns
        if note := clock.note():
            self.notes.append(note)
        times_ns = np.empty(len(of), dtype=np.int64)
        times_ns[by_topic] = clock.times_ns(ordered_ns, epoch_of)
        self._times_ns = times_ns
        del split, epoch_of, ordered_ns
        sizes, headers = _joined(all_sizes), _joined(all_headers)
        self._arrivals: dict[str, tuple[Integers, Arrivals]] = {}
        for topic, rows in zip(topics, np.split(by_topic, bounds) if topics else [], strict=True):
            rows = rows[np.argsort(times_ns[rows], kind="stable")]
            own_ns, own_headers = times_ns[rows], headers[rows]
            if (own_headers == _NO_STAMP).any():
                own_headers = _NONE.copy()
            self._arrivals[topic.name] = own_ns, Arrivals(
                topic.msgtype, read_only(own_ns / 1e9), read_only(sizes[rows]),
                read_only(own_headers),
            )  # fmt: skip
            notes = {kept.finish(times_ns) for kept in topic.kept.values()}
            self.notes += sorted(f"{topic.name}: {note}." for note in notes if note)
            if topic.undecodable:
                self.notes.append(
                    f"{topic.name} ({topic.msgtype}, {len(rows) / max(1, len(of)):.0%} of the "
                    f"messages) is not decoded, only its times and sizes are used: "
                    f"{topic.undecodable}"
                )

    def span(self, span: Span, graph: RosGraph | None, intervals: Iterable[Interval]) -> Window:
        """Return what every plugin sees of a span."""
        past = tuple(each for each in intervals if each.start_s < span.end_s)
        arrivals = {name: self._within(name, span) for name in sorted(self._topics)}
        system = None if graph is None else nx.freeze(system_view(graph))
        return Window(
            span.start_s, span.end_s, graph, system, past, arrivals, roles=self._roles,
            shared=self._shared,
        )  # fmt: skip

    def _within(self, topic: str, span: Span) -> Arrivals:
        times_ns, arrivals = self._arrivals[topic]
        part = span.of(times_ns)
        _, times_s, sizes, stamps_ns = arrivals
        return Arrivals(arrivals.msgtype, times_s[part], sizes[part], stamps_ns[part])

    def window(self, plugin: FeaturePlugin, span: Span, common: Window) -> Window | Missing:
        """Return what one plugin sees of a span, or why it can see nothing."""
        requests = self._kept[plugin.name]
        if plugin.needs_graph and common.graph is None:
            return Missing("the bag was recorded without graphs")
        for key, request in plugin.topics.items():
            for name, kept in requests[key].items():
                if kept.error:
                    return Missing(f"{name} cannot be used: {kept.error}")
            if not request.optional and not requests[key]:
                return Missing(f"no topic {request} is recorded")
        topics = _cut(requests, span, silent=False)
        for key, request in plugin.topics.items():
            if not request.optional and not topics[key]:
                return Missing(f"no message on {', '.join(requests[key])} in this window")
        history = _cut(requests, Span(0, span.end_ns), silent=True)
        return replace(common, topics=topics, history=history)


def _too_large(data: bytes) -> str:
    return (
        f"a message of {len(data)} bytes is not decoded; the limit is {LARGEST_DECODED} "
        "(LARGEST_DECODED)"
    )


def _by_topic(
    topics: list[_Topic], numbers: Integers, rows: Integers
) -> Iterator[tuple[_Topic, list[int]]]:
    """Yield the topics of rows that are in order of the topic, and the rows of each."""
    if len(rows):
        for some in np.split(rows, np.flatnonzero(np.diff(numbers[rows])) + 1):
            yield topics[numbers[some[0]]], some.tolist()


def _joined(parts: list[Integers]) -> Integers:
    """Return some arrays as one, and let go of them: of millions of messages, each copy counts."""
    whole = np.concatenate([_NONE, *parts])
    parts.clear()
    return whole


def _cut(
    requests: Mapping[str, Mapping[str, KeptRows]], span: Span, *, silent: bool
) -> dict[str, dict[str, Series]]:
    return {
        key: {
            name: series
            for name, kept in topics.items()
            if len((series := kept.within(span)).times_s) or silent
        }
        for key, topics in requests.items()
    }
