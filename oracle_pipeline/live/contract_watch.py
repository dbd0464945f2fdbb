"""Compares a running robot with the contract of its normal recordings, once a second.

A breach, such as a silent topic or a new node, needs no statistics and no window. It must be found
twice in a row, because discovery reports a node and its endpoints one by one.
"""

import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TypeAlias

from oracle_pipeline.bags.discovery import Discovery, Endpoint
from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.bags.reader import Topic
from oracle_pipeline.live.graph_snapshot import snapshot
from oracle_pipeline.robots.robot import names_of_robots
from oracle_pipeline.scoring.alarms import REPEAT_S
from oracle_pipeline.scoring.contract import (
    Breach,
    Contract,
    Observation,
    TopicTerms,
    graph_elements,
    qos_words,
)
from oracle_pipeline.scoring.fingerprints import MESSAGES, RecentRepeats
from oracle_pipeline.scoring.pace import SPAN_S

CONSECUTIVE = 2  # checks in a row that must find a breach before it is reported
STARTUP_S = 60.0  # until then, missing nodes and topics are not reported [s]
_AT_ONCE_S = 1.0  # in which the steady topics of a robot that is up have a message


class ContractWatch:
    """Compares the nodes, topics and rates of each robot of a domain with a contract.

    Parameters
    ----------
    contract : Contract
    topics : mapping of str to str
        Topics of known types, and these; more may come.
    """

    def __init__(self, contract: Contract, topics: Mapping[str, str]) -> None:
        self._contract, self._topics = contract, topics
        self._arrivals: dict[str, _Arrivals] = {}  # by topic
        self._robots: dict[str, _RobotWatch] = {}

    def add(self, topic: str, at_s: float, message: bytes) -> None:
        """Take a message that arrived at a time of the recording [s]."""
        if topic not in self._arrivals:
            self._arrivals[topic] = _Arrivals(at_s, self._topics[topic])
        self._arrivals[topic].add(at_s, message)

    def forget(self) -> None:
        """Begin anew with messages, since some were lost or late."""
        self._arrivals.clear()

    def is_whole(self, graph: RosGraph) -> bool:
        """Return whether a graph has all that is always there: the robot may be leaving."""
        return self._contract.always <= graph_elements(graph)

    def is_up(self, since_s: float) -> bool:
        """Return whether the robots had started by a time, or had `STARTUP_S` for it.

        A robot that starts has another rate, and no scan yet: that is no fault.
        """
        started = [robot.started_s <= since_s + _AT_ONCE_S for robot in self._robots.values()]
        return since_s >= STARTUP_S or (bool(started) and all(started))

    def check(self, now_s: float, discovery: Discovery) -> tuple[Breach, ...]:
        """Return the breaches to report; call it once a second.

        Parameters
        ----------
        now_s : float
            Time of the recording [s].
        discovery : Discovery
            Of the same domain.
        """
        publishers = {
            name: endpoints
            for name, endpoints in discovery.topics().items()
            if name in self._topics and not is_hidden(name)
        }
        if not publishers:  # the robot has left
            self._arrivals.clear()
            return ()
        graph = graph_elements(snapshot(discovery, {}))
        topics = {name: Topic(name, e[0].msgtype, 0, ()) for name, e in publishers.items()}
        found: dict[str, Breach] = {}  # by sentence: robots share nodes
        for robot, _, names in names_of_robots(topics):
            watch = self._robots.setdefault(robot, _RobotWatch(self._contract))
            seen = {own: (name, publishers[name]) for name, own in names.items()}
            for breach in watch.check(now_s, seen, graph, self._arrivals):
                of = f"{robot}: " if robot and breach.term != "graph" else ""
                found[of + breach.text] = breach._replace(text=of + breach.text)
        for name in publishers.keys() & self._arrivals.keys():
            self._arrivals[name].end_second()
        return tuple(found.values())


_Seen: TypeAlias = Mapping[str, tuple[str, Sequence[Endpoint]]]  # recorded name, publishers


class _RobotWatch:
    """Compares one robot with a contract, whose topics have names relative to it.

    Attributes
    ----------
    started_s : float
        When the last of its steady topics had its first message; infinite until then [s].
    """

    def __init__(self, contract: Contract) -> None:
        self.started_s = math.inf
        self._contract = contract
        always = {n: terms for n, terms in contract.topics.items() if terms.always}
        self._steady = {n for n, terms in always.items() if terms.lowest_hz is not None}
        self._topics: set[str] = set()  # that have existed so far
        self._graph: frozenset[str] = frozenset()  # elements that have existed so far
        self._lasting: dict[str, int] = {}  # checks in a row that found a breach, by its name
        self._reported_s: dict[str, float] = {}  # when a breach was last reported, by its name

    def check(
        self, now_s: float, seen: _Seen, graph: frozenset[str], arrivals: Mapping[str, "_Arrivals"]
    ) -> Iterator[Breach]:
        """Yield the breaches to report."""
        came = {own: arrivals[name] for own, (name, _) in seen.items() if name in arrivals}
        if self._steady <= came.keys():
            last_s = max((came[own].first_s for own in self._steady), default=0.0)
            self.started_s = min(self.started_s, last_s)
        came = came if now_s >= min(self.started_s, STARTUP_S) else {}
        found = self._contract.breaches(self._observed(now_s, seen, graph, came), rates=False)
        found += self._of_pace(now_s, came)
        found = _without_consequences(found)
        self._lasting = {each.name: self._lasting.get(each.name, 0) + 1 for each in found}
        for each in found:
            if self._is_due(each.name, now_s):
                self._reported_s[each.name] = now_s
                yield each

    def _is_due(self, name: str, now_s: float) -> bool:
        is_news = now_s - self._reported_s.get(name, -math.inf) >= REPEAT_S
        return is_news and self._lasting[name] >= CONSECUTIVE

    def _observed(
        self, now_s: float, seen: _Seen, graph: frozenset[str], came: Mapping[str, "_Arrivals"]
    ) -> Observation:
        """Return what exists now; while the robot starts, together with what has yet to start."""
        contract = self._contract
        self._topics |= seen.keys()
        self._graph |= graph
        topics = {
            own: _shown(endpoints, contract.topics.get(own))
            for own, (name, endpoints) in seen.items()
            if own in contract.topics or not _is_in(name, contract.ever)
        }
        if now_s < STARTUP_S:
            graph |= contract.always - self._graph
            to_come = contract.topics.keys() - self._topics
            topics |= {name: (contract.topics[name].types[0], (), None) for name in to_come}
        repeats = {own: {MESSAGES: max(of.repeats)} for own, of in came.items()}
        return Observation(topics, graph, repeats=repeats)

    def _of_pace(self, now_s: float, came: Mapping[str, "_Arrivals"]) -> Iterator[Breach]:
        """Yield breaches of rate of the topics that have a publisher."""
        for own, arrived in came.items():
            breach = self._contract.breach_of_silence(own, now_s - arrived.last_s)
            if breach is None and arrived.is_full:
                breach = self._contract.breach_of_count(own, sum(arrived.counts))
            if breach is not None:
                yield breach


class _Arrivals:
    """Messages and the longest repeat of each of the last seconds, from the first message on."""

    def __init__(self, first_s: float, msgtype: str) -> None:
        self.first_s = self.last_s = first_s
        self.counts, self.repeats = (deque([0], maxlen=SPAN_S) for _ in range(2))
        self._recent = RecentRepeats(msgtype)
        self._ended = 0

    @property
    def is_full(self) -> bool:
        """Whether all counted seconds are whole."""
        return self._ended >= SPAN_S  # the first message came within a second

    def add(self, at_s: float, message: bytes) -> None:
        """Take the next message."""
        self.last_s = at_s
        self.counts[-1] += 1
        self.repeats[-1] = max(self.repeats[-1], self._recent.add(message))

    def end_second(self) -> None:
        """Take the messages of the next second."""
        self.counts.append(0)
        self.repeats.append(0)
        self._ended += 1


def _without_consequences(found: Sequence[Breach]) -> list[Breach]:
    """Return one breach for each name, and no edge of what is itself new or gone."""
    by_name = {breach.name: breach for breach in reversed(found)}
    ends = {*by_name, *(f"topic:{name}" for name in by_name)}
    return [
        breach
        for name, breach in reversed(by_name.items())
        if " -> " not in name or ends.isdisjoint(name.split(" -> "))
    ]


def _shown(
    publishers: Sequence[Endpoint], terms: TopicTerms | None
) -> tuple[str, tuple[str, ...], None]:
    """Return type and QoS profiles of a topic; of several types, one outside the terms."""
    types = [endpoint.msgtype for endpoint in publishers]
    foreign = (each for each in types if terms is not None and each not in terms.types)
    return next(foreign, types[0]), qos_words(endpoint.qos for endpoint in publishers), None


def _is_in(topic: str, elements: Collection[str]) -> bool:
    """Return whether a topic is in a graph: it may exist without being recorded."""
    return any(f"topic:{topic}" in element.split(" -> ") for element in elements)
