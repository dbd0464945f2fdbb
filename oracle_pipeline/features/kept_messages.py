"""One pass over a bag for all plugins: what they keep of its messages, as arrays.

Each message is decoded at most once, and only if a plugin asked for it. Windows are slices of the
arrays.
"""

import math
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.features.message_layout import MessageLayout
from oracle_pipeline.features.plugin import (
    Arrivals,
    FeaturePlugin,
    Missing,
    RawRecord,
    Request,
    Series,
    Window,
)
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.graphs.views import system_view


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of a recording: from a nanosecond after its start to the one before another."""

    start_ns: int
    end_ns: int

    @property
    def start_s(self) -> float:
        """Start [s]."""
        return self.start_ns / 1e9

    @property
    def end_s(self) -> float:
        """End [s]."""
        return self.end_ns / 1e9

    def of(self, times_ns: "array[int]") -> slice:
        """Return which of ascending times are in the span."""
        return slice(bisect_left(times_ns, self.start_ns), bisect_left(times_ns, self.end_ns))


class _Kept:
    """What one request keeps of one topic."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self.error = ""  # why there is nothing to be had from this topic
        self.due_ns: float = 0  # before that no message is wanted
        self._every_ns = round(request.every_s * 1e9)
        self._times_ns = array("q")
        self._rows: list[Any] = []

    def add(self, time_ns: int, message: Any) -> None:
        """Keep what is wanted of a message that is due."""
        if self._every_ns:
            self.due_ns = (time_ns // self._every_ns + 1) * self._every_ns
        try:
            row = self.request.keep(message)
        except Exception as error:  # foreign code
            self.fail(f"{type(error).__name__}: {error}")
            return
        if row is not None:
            self._rows.append(row)
            self._times_ns.append(time_ns)

    def fail(self, error: str) -> None:
        """Give the topic up."""
        self.error, self.due_ns = error, math.inf

    def finish(self) -> None:
        """Make arrays of all that was kept, in time order."""
        try:
            values: NDArray[Any] = (
                np.fromiter(self._rows, dtype=object, count=len(self._rows))
                if np.dtype(self.request.dtype) == object
                else np.array(self._rows, dtype=self.request.dtype)
            )
        except ValueError as error:
            self.error = f"what is kept of each message must have the same shape: {error}"
            return
        times_s, order = _in_order(self._times_ns)
        self._series = Series(times_s, _read_only(values[order]))

    def within(self, span: Span) -> Series:
        part = span.of(self._times_ns)
        return Series(self._series.times_s[part], self._series.values[part])


class _Topic:
    """One topic of the bag: when its messages came, and what is kept of them."""

    def __init__(self, msgtype: str, layout: MessageLayout) -> None:
        self.msgtype, self.layout = msgtype, layout
        self.kept: dict[int, _Kept] = {}  # by identity of the request
        self._times_ns = array("q")
        self._sizes = array("q")
        self._header_stamps_ns = array("q")

    def add(self, time_ns: int, message: RawMessage, bag: BagReader) -> None:
        self._times_ns.append(time_ns)
        self._sizes.append(len(message.data))
        if (stamp_ns := self.layout.header_stamp_ns(message.data)) is not None:
            self._header_stamps_ns.append(stamp_ns)
        content: Any = None
        for kept in self.kept.values():
            if time_ns < kept.due_ns:
                continue
            if kept.request.raw:
                kept.add(time_ns, RawRecord(message.data, self.layout))
                continue
            try:
                content = content or bag.deserialize(message)
            except BagError as error:
                kept.fail(str(error))
            else:
                kept.add(time_ns, content)

    def finish(self) -> None:
        """Make arrays, in time order."""
        sizes = np.array(self._sizes, dtype=np.int64)
        stamps_ns = np.array(self._header_stamps_ns, dtype=np.int64)
        times_s, order = _in_order(self._times_ns)
        stamps_ns = stamps_ns[order] if len(stamps_ns) == len(order) else stamps_ns[:0]
        self._all = Arrivals(self.msgtype, times_s, _read_only(sizes[order]), _read_only(stamps_ns))
        for kept in self.kept.values():
            kept.finish()

    def within(self, span: Span) -> Arrivals:
        part = span.of(self._times_ns)
        _, times_s, sizes, stamps_ns = self._all
        return Arrivals(self.msgtype, times_s[part], sizes[part], stamps_ns[part])


class KeptMessages:
    """When the messages of a bag came, and what plugins kept of them."""

    def __init__(self, bag: BagReader, plugins: tuple[FeaturePlugin, ...]) -> None:
        self._topics = {
            name: _Topic(topic.msgtype, MessageLayout(bag, name))
            for name, topic in sorted(bag.topics.items())
        }
        self._kept: dict[str, dict[str, dict[str, _Kept]]] = {
            plugin.name: {
                key: {
                    name: topic.kept.setdefault(id(request), _Kept(request))
                    for name, topic in self._topics.items()
                    if request.matches(bag.topics[name], topic.layout)
                }
                for key, request in plugin.topics.items()
            }
            for plugin in plugins
        }

    @classmethod
    def read(
        cls,
        bag: BagReader,
        plugins: tuple[FeaturePlugin, ...],
        every_message: Callable[[RawMessage], None] | None = None,
    ) -> Self:
        """Read a bag.

        Parameters
        ----------
        bag, plugins
            What to read, and for whom.
        every_message : callable, optional
            Called with each message of the bag, asked for or not.
        """
        recording = cls(bag, plugins)
        topics, start_ns = recording._topics, bag.start_ns
        for message in bag.messages():
            if every_message is not None:
                every_message(message)
            topics[message.topic].add(message.stamp_ns - start_ns, message, bag)
        for topic in topics.values():
            topic.finish()
        return recording

    def span(self, span: Span, graph: RosGraph | None, intervals: Iterable[Interval]) -> Window:
        """Return what every plugin sees of a span."""
        past = tuple(each for each in intervals if each.start_s < span.end_s)
        arrivals = {name: topic.within(span) for name, topic in self._topics.items()}
        system = None if graph is None else nx.freeze(system_view(graph))
        return Window(span.start_s, span.end_s, graph, system, past, arrivals)

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


def _cut(
    requests: Mapping[str, Mapping[str, _Kept]], span: Span, *, silent: bool
) -> dict[str, dict[str, Series]]:
    return {
        key: {
            name: series
            for name, kept in topics.items()
            if len((series := kept.within(span)).times_s) or silent
        }
        for key, topics in requests.items()
    }


def _in_order(times_ns: "array[int]") -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Sort times in place; return them [s], and from where each came."""
    unsorted_ns = np.array(times_ns, dtype=np.int64)
    order = np.argsort(unsorted_ns, kind="stable")
    sorted_ns = unsorted_ns[order]
    times_ns[:] = array("q", sorted_ns.tobytes())
    return _read_only(sorted_ns / 1e9), order


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values
