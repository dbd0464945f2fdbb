"""What plugins keep of the messages of a bag, which is read once for all of them.

Each message is decoded at most once, and only if a plugin requested it. Windows are slices of what
was kept.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.kept_rows import Carried, KeptRows
from oracle_pipeline.features.engine.kept_topic import KeptTopic
from oracle_pipeline.features.engine.memory import MemoryBudget
from oracle_pipeline.features.engine.message_index import MessageIndex
from oracle_pipeline.features.engine.message_layout import MessageLayout
from oracle_pipeline.features.engine.message_pass import MessagePass
from oracle_pipeline.features.engine.spans import Integers, Span
from oracle_pipeline.features.engine.timeline import Timeline
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.robots.robot import Robot, find_robots


class Graphs(NamedTuple):
    """The ROS graphs of a span, the same for every plugin."""

    graph: RosGraph | None
    system: RosGraph | None
    intervals: tuple[Interval, ...]


NO_GRAPH = Graphs(None, None, ())


def decoded_topics(bag: BagReader, plugins: Iterable[fp.FeaturePlugin]) -> frozenset[str]:
    """Return the topics of a bag whose decoded messages are requested by any plugin."""
    requests = [r for plugin in plugins for r in plugin.topics.values() if not r.raw]
    return frozenset(
        robot.bag.recorded(name)
        for robot in find_robots(bag)
        for name, topic in robot.bag.topics.items()
        if any(r.matches(topic, MessageLayout(robot.bag, name), robot.roles) for r in requests)
    )


class KeptMessages:
    """The times of the messages of a bag, and the values that plugins keep of them.

    Attributes
    ----------
    clock : Timeline
        The recorder's, with the steps that it made.
    notes : list of str
        The messages that were not used, with the reasons.
    shared : dict
        Results that the plugins share, ``Window.shared``.
    """

    clock: Timeline
    notes: list[str]

    def __init__(self, robot: Robot, plugins: tuple[fp.FeaturePlugin, ...]) -> None:
        bag, self._roles, self._used = robot.bag, robot.roles, sorted(robot.used)
        self.shared: dict[Any, Any] = {}
        self._budget = MemoryBudget()
        self._topics = {name: KeptTopic(bag, topic) for name, topic in bag.topics.items()}
        self._kept: dict[str, dict[str, dict[str, KeptRows]]] = {
            plugin.name: {
                key: {
                    name: self._topics[name].ask(request, self._budget)
                    for name in self._used
                    if request.matches(bag.topics[name], self._topics[name].layout, robot.roles)
                }
                for key, request in plugin.topics.items()
            }
            for plugin in plugins
        }

    @classmethod
    @np.errstate(all="ignore")  # messages hold NaN and infinity
    def read(
        cls,
        robot: Robot,
        plugins: tuple[fp.FeaturePlugin, ...],
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
        recording = cls(robot, plugins)
        topics = list(recording._topics.values())
        reading = MessagePass(topics, robot.bag.start_ns)
        index = MessageIndex([topic.layout for topic in topics])
        for batch in robot.bag.batches():
            if see is not None:
                see(batch)
            recording._budget.count(len(batch.topics))
            reading.take(batch)
            index.add(batch)
        reading.end()
        index.close(robot.bag, jumps=carried is None)
        recording._close(index, carried or {})
        return recording

    def carried(self) -> Carried:
        """Return the rows that later windows need after their messages are dropped."""
        return {
            (topic.name, key): kept.last()
            for topic in self._topics.values()
            for key, kept in topic.kept.items()
            if kept.request.carried and not kept.error
        }

    @property
    def times_ns(self) -> Integers:
        """Times of all messages in the order of reading, since the start [ns]."""
        return self._times_ns

    def occupied(self) -> Integers:
        """Return the sorted times of all messages since the start [ns]."""
        return np.sort(self._times_ns)

    def span(self, span: Span, graphs: Graphs) -> fp.Window:
        """Return the part of a span's window that is the same for every plugin."""
        arrivals = {name: self._within(name, span) for name in self._used}
        return fp.Window(
            span.start_s, span.end_s, *graphs, arrivals, roles=self._roles, shared=self.shared
        )

    def window(
        self, plugin: fp.FeaturePlugin, span: Span, common: fp.Window, prepared: Any = None
    ) -> fp.Window | fp.Missing:
        """Return the window of a span for one plugin, or the reason why it has none."""
        requests = self._kept[plugin.name]
        if plugin.needs_graph and common.graph is None:
            return fp.Missing("no ROS graph was recorded before the end of the window")
        for key, request in plugin.topics.items():
            for name, kept in requests[key].items():
                if kept.error:
                    return fp.Missing(f"{name} cannot be used: {kept.error}")
            if not request.optional and not requests[key]:
                return fp.Missing(f"no topic {request} is recorded")
        window = self.usable(plugin, span, common)
        for key, request in plugin.topics.items():
            if not request.optional and not window.topics[key]:
                return fp.Missing(f"no message on {', '.join(requests[key])} in this window")
        return replace(window, prepared=prepared)

    def usable(self, plugin: fp.FeaturePlugin, span: Span, common: fp.Window) -> fp.Window:
        """Return the window of a span for one plugin, without the topics that cannot be used."""
        requests = self._kept[plugin.name]
        history = _Slices(requests, Span(0, span.end_ns), silent=True)
        return replace(common, topics=_Slices(requests, span, silent=False), history=history)

    def _close(self, index: MessageIndex, carried: Carried) -> None:
        """Convert what was kept to arrays by time; note what was not used."""
        self.clock, self.notes = index.clock, index.notes
        self._times_ns = index.times_ns
        self._arrivals: dict[str, tuple[Integers, fp.TopicArrivals]] = {}
        undecodable: dict[str, dict[str, int]] = {}  # by reason: topics, and their messages
        for number, topic in enumerate(self._topics.values()):
            times_ns, arrivals = index.arrivals(number, topic.msgtype)
            self._arrivals[topic.name] = times_ns, arrivals
            notes = {
                kept.close(index.times_ns, carried.get((topic.name, key)))
                for key, kept in topic.kept.items()
            }
            if not topic.undecodable:
                self.notes += sorted(f"{topic.name}: {note.rstrip('.')}." for note in notes if note)
            elif len(times_ns):
                undecodable.setdefault(topic.undecodable, {})[topic.name] = len(times_ns)
        for reason, messages in undecodable.items():
            share = sum(messages.values()) / len(index)
            self.notes.append(
                f"Only the times and sizes of {', '.join(messages)} are used ({share:.0%} of the "
                f"messages): {reason}"
            )

    def _within(self, topic: str, span: Span) -> fp.TopicArrivals:
        times_ns, arrivals = self._arrivals[topic]
        part = span.slice_of(times_ns)
        msgtype, times_s, sizes, stamps_ns = arrivals
        return fp.TopicArrivals(msgtype, times_s[part], sizes[part], stamps_ns[part])


class _Slices(Mapping[str, Mapping[str, fp.Series]]):
    """What was kept within a span, by key of the request; cut on access, as few plugins use it."""

    def __init__(
        self, requests: Mapping[str, Mapping[str, KeptRows]], span: Span, *, silent: bool
    ) -> None:
        self._requests = requests
        self._span = span
        self._silent = silent  # topics without a row are there, too

    def __getitem__(self, key: str) -> Mapping[str, fp.Series]:
        usable = {name: kept for name, kept in self._requests[key].items() if not kept.error}
        series = {name: kept.within(self._span) for name, kept in usable.items()}
        return {name: each for name, each in series.items() if self._silent or len(each.times_s)}

    def __iter__(self) -> Iterator[str]:
        return iter(self._requests)

    def __len__(self) -> int:
        return len(self._requests)
