"""Compares a running robot with the contract of its normal recordings, once a second.

A departure, such as a silent topic or a new node, needs no statistics and no window. It must be
seen twice in a row, because discovery reports a node and its endpoints one by one.
"""

import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence

from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.live.discovery import Discovery, Endpoint
from oracle_pipeline.live.traffic import snapshot
from oracle_pipeline.scoring.alarms import REPEAT_S
from oracle_pipeline.scoring.contract import (
    Breach,
    Contract,
    Observation,
    TopicTerms,
    graph_elements,
    qos_words,
)
from oracle_pipeline.scoring.pace import SPAN_S

LASTS = 2  # looks in a row that see a breach until it is told
STARTED_S = 60.0  # by then all is there that normal recordings have; before, nothing is missed [s]


class ContractWatch:
    """Compares what is on a domain with a contract.

    Parameters
    ----------
    contract : Contract
    """

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self._said: dict[str, _Said] = {}  # by topic
        self._topics: set[str] = set()  # that were there at any time
        self._graph: frozenset[str] = frozenset()  # what of it was there at any time
        self._lasting: dict[str, int] = {}  # looks in a row that saw a breach, by its name
        self._told_s: dict[str, float] = {}  # when a breach was told last, by its name

    def hear(self, topic: str, at_s: float) -> None:
        """Count a message that came at a time of the recording [s]."""
        said = self._said.get(topic)
        if said is None:
            said = self._said[topic] = _Said()
        said.last_s = at_s
        said.counts[-1] += 1

    def look(
        self, now_s: float, discovery: Discovery, heard: Collection[str]
    ) -> tuple[Breach, ...]:
        """Return the breaches to report; call it once a second.

        Parameters
        ----------
        now_s : float
            Time of the recording [s].
        discovery : Discovery
            Who is there.
        heard : collection of str
            Topics whose types are known.
        """
        publishers = {
            name: endpoints
            for name, endpoints in discovery.topics().items()
            if name in heard and not is_hidden(name)
        }
        if not publishers:  # the robot has left
            self._said.clear()
            return ()
        seen = self._observed(now_s, publishers, graph_elements(snapshot(discovery, {})))
        found = [*self._contract.breaches(seen, rates=False), *self._of_pace(now_s, publishers)]
        found = _without_consequences(found)
        self._lasting = {each.name: self._lasting.get(each.name, 0) + 1 for each in found}
        told = tuple(each for each in found if self._is_due(each.name, now_s))
        self._told_s |= dict.fromkeys((each.name for each in told), now_s)
        return told

    def _is_due(self, name: str, now_s: float) -> bool:
        is_news = now_s - self._told_s.get(name, -math.inf) >= REPEAT_S
        return is_news and self._lasting[name] >= LASTS

    def _observed(
        self, now_s: float, publishers: Mapping[str, Sequence[Endpoint]], graph: frozenset[str]
    ) -> Observation:
        """Return what is there; while a robot starts, with all that is still to come."""
        contract = self._contract
        self._topics |= publishers.keys()
        self._graph |= graph
        topics = {
            name: _shown(endpoints, contract.topics.get(name))
            for name, endpoints in publishers.items()
            if name in contract.topics or not _is_in(name, contract.ever)
        }
        if now_s < STARTED_S:
            graph |= contract.always - self._graph
            to_come = contract.topics.keys() - self._topics
            topics |= {name: (contract.topics[name].types[0], (), None) for name in to_come}
        return Observation(topics, graph)

    def _of_pace(self, now_s: float, publishers: Collection[str]) -> Iterator[Breach]:
        """Yield breaches of pace of the topics that somebody publishes."""
        for name, said in self._said.items():
            if name not in publishers:
                continue
            breach = self._contract.breach_of_silence(name, now_s - said.last_s)
            if breach is None and said.is_full():
                breach = self._contract.breach_of_count(name, sum(said.counts))
            if breach is not None:
                yield breach
            said.counts.append(0)


class _Said:
    """How many messages came in each of the last seconds, from the first message on."""

    def __init__(self) -> None:
        self.last_s = 0.0
        self.counts: deque[int] = deque([0], maxlen=SPAN_S)
        self._looks = 0

    def is_full(self) -> bool:
        """Tell whether the seconds since the first message are enough."""
        self._looks += 1
        return self._looks > SPAN_S  # the first second was not whole


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
    """Return type and profiles of a topic; if its types differ, one that is not in the terms."""
    types = [endpoint.msgtype for endpoint in publishers]
    foreign = (each for each in types if terms is not None and each not in terms.types)
    return next(foreign, types[0]), qos_words(endpoint.qos for endpoint in publishers), None


def _is_in(topic: str, elements: Collection[str]) -> bool:
    """Tell whether a graph knows a topic: it may have been there without being recorded."""
    return any(f"topic:{topic}" in element.split(" -> ") for element in elements)
