"""One pass over a bag for all plugins: what they keep of its messages, as arrays.

Each message is decoded at most once, and only on topics that a plugin asked for. Windows are
slices of the arrays.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.features.plugin import FeaturePlugin, Missing, Request, Series, Window


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


class _Kept:
    """What one request keeps of one topic."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self.error = ""  # why there is nothing to be had from this topic
        self._stamps_ns: list[int] = []
        self._rows: list[Any] = []

    def add(self, stamp_ns: int, message: Any) -> None:
        if self.error:
            return
        try:
            self._rows.append(self.request.keep(message))
        except Exception as error:  # foreign code
            self.error = f"{type(error).__name__}: {error}"
        else:
            self._stamps_ns.append(stamp_ns)

    def finish(self, start_ns: int) -> None:
        """Make arrays of all that was kept, in time order."""
        stamps = np.array(self._stamps_ns, dtype=np.int64) - start_ns
        try:
            values: NDArray[Any] = (
                np.fromiter(self._rows, dtype=object, count=len(self._rows))
                if np.dtype(self.request.dtype) == object
                else np.array(self._rows, dtype=self.request.dtype)
            )
        except ValueError as error:
            self.error = f"what is kept of each message must have the same shape: {error}"
            return
        order = np.argsort(stamps, kind="stable")
        self._times_ns = stamps[order]
        times_s, values = self._times_ns / 1e9, values[order]
        times_s.flags.writeable = values.flags.writeable = False
        self._series = Series(times_s, values)

    def between(self, start_ns: int, end_ns: int) -> Series:
        first, after = np.searchsorted(self._times_ns, (start_ns, end_ns))
        return Series(self._series.times_s[first:after], self._series.values[first:after])


class Recording:
    """The kept messages of a bag, by plugin."""

    def __init__(self, bag: BagReader, plugins: tuple[FeaturePlugin, ...]) -> None:
        self._kept: dict[str, dict[str, dict[str, _Kept]]] = {
            plugin.name: {
                key: {
                    name: _Kept(request)
                    for name, topic in sorted(bag.topics.items())
                    if request.matches(topic)
                }
                for key, request in plugin.topics.items()
            }
            for plugin in plugins
        }
        self._by_topic: dict[str, list[_Kept]] = defaultdict(list)
        for requests in self._kept.values():
            for topics in requests.values():
                for name, kept in topics.items():
                    self._by_topic[name].append(kept)

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
        wanted = recording._by_topic
        for message in bag.messages(wanted.keys() if every_message is None else None):
            if every_message is not None:
                every_message(message)
            if message.topic in wanted:
                recording._add(bag, message)
        for topics in wanted.values():
            for kept in topics:
                kept.finish(bag.start_ns)
        return recording

    def window(self, plugin: FeaturePlugin, span: Span, graph: RosGraph | None) -> Window | Missing:
        """Return what a plugin sees of a span, or why it can see nothing."""
        requests = self._kept[plugin.name]
        if plugin.needs_graph and graph is None:
            return Missing("the bag was recorded without graphs")
        for key, request in plugin.topics.items():
            for name, kept in requests[key].items():
                if kept.error:
                    return Missing(f"{name} cannot be used: {kept.error}")
            if not request.optional and not requests[key]:
                return Missing(f"no topic {request} is recorded")
        topics = _cut(requests, span.start_ns, span.end_ns, silent=False)
        for key, request in plugin.topics.items():
            if not request.optional and not topics[key]:
                return Missing(f"no message on {', '.join(requests[key])} in this window")
        history = _cut(requests, 0, span.end_ns, silent=True)
        return Window(span.start_s, span.end_s, graph, topics, history)

    def _add(self, bag: BagReader, message: RawMessage) -> None:
        interested = [kept for kept in self._by_topic[message.topic] if not kept.error]
        if not interested:
            return
        try:
            decoded = bag.deserialize(message)
        except BagError as error:
            for kept in interested:
                kept.error = str(error)
            return
        for kept in interested:
            kept.add(message.stamp_ns, decoded)


def _cut(
    requests: Mapping[str, Mapping[str, _Kept]], start_ns: int, end_ns: int, *, silent: bool
) -> dict[str, dict[str, Series]]:
    return {
        key: {
            name: series
            for name, kept in topics.items()
            if len((series := kept.between(start_ns, end_ns)).times_s) or silent
        }
        for key, topics in requests.items()
    }
