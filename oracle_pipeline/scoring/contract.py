"""The contract of a system: topics, types, QoS, rates, nodes and edges of its normal recordings.

A breach of it needs no statistics, so it is reported as a sentence, before any p-value. Only topics
with a steady rate have a rate in the contract. A topic is a relay if most of its messages are
copies of those of another topic. A running robot is also compared with the pace of its topics: the
longest silence, and the number of messages in ten seconds.
"""

import math
import re
import textwrap
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np
from rosbags.interfaces import Qos

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.terminal import join_first
from oracle_pipeline.features.engine.timeline import Stamps, Timeline
from oracle_pipeline.features.signals.collector import SignalCollector
from oracle_pipeline.graphs.intervals import compose
from oracle_pipeline.opened_run import OpenedRun
from oracle_pipeline.robots.known import Known
from oracle_pipeline.robots.robot import Robot
from oracle_pipeline.scoring.constants import LIKE, OR, Samples, is_of_transform, likes
from oracle_pipeline.scoring.fingerprints import MESSAGES, Fingerprints, Relays, Repeats
from oracle_pipeline.scoring.pace import FEWEST, SPAN_S, Pace, Stamped, merged_paces, paces
from oracle_pipeline.scoring.parameters import PROCESS_SUFFIX, ReportedParameters

STEADY = 1.5  # largest ratio between the rates of normal recordings at which a rate is steady
MARGIN = 0.05  # relative margin on the rates of normal recordings, and on shares of copies
SILENCE_S = 1.0  # added to twice the longest silence of normal recordings, on a running robot [s]
FEWEST_RECORDINGS = 5  # with a topic, before a field counts as constant, or the topic as a relay
MOSTLY = 0.75  # share of a topic's messages that are copies in every recording, for a relay
FEW = 2  # messages of a relay, or of a steady topic, that may differ beyond the margin
COUNT_MARGIN = 0.1  # relative margin on message counts per `SPAN_S`, in addition to 2 messages
ROUNDED = 1e-3  # relative difference up to which a constant number counts as rounded
RARE = 0.01  # share of copies up to which all messages of a relay count as filtered
REPLAYED, REPEATS = 10, 3  # in a row, beside so many times as many as usual, are replayed
_NUMBER = re.compile(r"(?<![\w'])-?\d+(?:\.\d*)?(?:e[+-]?\d+)?(?![\w'])")
_ROUNDED = "the numbers differ by rounding"
_FILTERED = "all messages are altered, as a filter does, and the features say how much"
_UNSTEADY = "normal recordings differ in such terms, too"
_OTHER_MACHINE = "another machine or a full queue changes a rate as much"

Term: TypeAlias = Literal[
    "topic", "type", "qos", "rate", "constant", "copies", "repeats", "clock", "graph", "number",
    "robots", "parameter",
]  # fmt: skip
_SETS = ("always", "ever", "unsteady", "changed")  # of the attributes of a contract
NOTHING: Mapping[str, str] = MappingProxyType({})
NO_PARAMETERS = ReportedParameters({}, frozenset())
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class TopicTerms:
    """The terms of one topic, from normal recordings.

    Attributes
    ----------
    types : tuple of str
        Message types.
    qos : tuple of str
        Offered profiles as text; empty if the recordings do not contain them.
    lowest_hz, highest_hz : float or None
        Range of its rate; None if the rate is not steady.
    always : bool
        Whether every recording has it.
    """

    types: tuple[str, ...]
    qos: tuple[str, ...]
    lowest_hz: float | None
    highest_hz: float | None
    always: bool


class Breach(NamedTuple):
    """One way in which a recording departs from the contract.

    A note is what an honest filter, another machine or a normal recording does as well: it does not
    count as a breach.
    """

    name: str  # of a topic, a node or an edge; or "clock"
    text: str  # a sentence; that of a note has the reason
    term: Term = "topic"
    severity: Literal["breach", "note"] = "breach"


@dataclass(frozen=True, slots=True)
class Observation:
    """The interfaces of one recording, as far as a contract covers them.

    Attributes
    ----------
    topics : mapping of str to tuple
        Name -> message type, offered profiles as text, rate [Hz] or None.
    graph : frozenset of str or None
        Nodes, and edges as ``node:/a -> topic:/b``; None for a recording without graphs.
    paces : mapping of str to Pace
        Of the topics that have messages; empty unless requested.
    constants : mapping of str to mapping
        Topic -> field that never changes -> its value as text.
    relays : mapping of str to mapping
        Topic -> source -> how many of the topic's messages are copies of the source's.
    repeats : mapping of str to mapping
        Topic -> number, or `MESSAGES` -> length of the longest sequence that came before.
    losses : tuple of str
        What of the recording could not be read.
    whole : bool
        Whether no message was lost; if not, rates and copies prove nothing.
    roles, instead : mapping of str to tuple of str
        Role -> its topics; and, where the reference knows others, the topics that may play it.
    parameters : ReportedParameters
        Of the nodes, as far as events report them.
    entropies : mapping of str to float
        Of the bytes of each topic [bit], for `oracle compare`; empty unless requested.
    duration_s : float
        How long it is [s]; a rate proves nothing in a recording of a few messages.
    set_back : tuple of tuple
        When the recorder's clock was set back, and by how much [s].
    robots : int or None
        How many robots the recording has; None if unknown.
    """

    topics: Mapping[str, tuple[str, tuple[str, ...], float | None]]
    graph: frozenset[str] | None
    paces: Mapping[str, Pace] = field(default_factory=dict)
    constants: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    relays: Relays = field(default_factory=dict)
    repeats: Repeats = field(default_factory=dict)
    whole: bool = True
    losses: tuple[str, ...] = ()
    roles: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    instead: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    parameters: ReportedParameters = NO_PARAMETERS
    entropies: Mapping[str, float] = field(default_factory=dict)
    duration_s: float = math.inf
    set_back: tuple[tuple[float, float], ...] = ()
    robots: int | None = None


class Observer:
    """Observes a recording while the caller reads its bag.

    Parameters
    ----------
    robot : Robot
        Whose bag is read.
    paced : bool
        Whether to measure paces and entropies too, which are needed of references only.

    Attributes
    ----------
    samples : Samples
        Of the messages seen.
    fingerprints : Fingerprints
        Of the messages seen, to find relays and repeats.
    signals : SignalCollector
        Of the messages seen.
    """

    def __init__(self, robot: Robot, *, paced: bool = False) -> None:
        self.samples = Samples(robot.bag)
        self.fingerprints = Fingerprints(robot.bag)
        self.signals = SignalCollector(robot)
        self._bag = robot.bag
        self._paced = paced
        self._seen: list[Stamped] = []

    def see(self, batch: Messages) -> None:
        """Take note of the next messages of the bag."""
        for number, rows in batch.by_topic():
            self.samples.add(batch, number, rows)
            self.fingerprints.add(batch, number, rows)
        self.signals.see(batch)
        if self._paced:
            self._seen.append(Stamped(batch.topics.astype(np.int16), batch.stamps_ns))

    def observation(self, run: OpenedRun, clock: Timeline, times_ns: Stamps) -> Observation:
        """Return the observation of the recording, once its bag was read.

        Parameters
        ----------
        run : OpenedRun
        clock : Timeline
            Of the recording.
        times_ns : ndarray of shape (n_messages,)
            Of each message in the order of reading, since the start of the recording.
        """
        duration_s = (clock.duration_ns - 1) * 1e-9
        topics = {
            name: (topic.msgtype, qos_words(topic.qos), _rate(topic.count, duration_s))
            for name, topic in self._bag.topics.items()
        }
        graph = graph_elements(compose(each.graph for each in run.intervals))
        return Observation(
            topics, graph if run.intervals else None, paces(self._bag, self._seen),
            self.samples.constants(), self.fingerprints.relays(),
            self.fingerprints.repeats(self.signals.signals(times_ns)),
            not run.disturbances.loss(), tuple(run.bag.losses),
            parameters=self.samples.parameters(),
            entropies=self.samples.entropies() if self._paced else {},
            duration_s=max(duration_s, 1e-9), set_back=clock.set_back,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Contract:
    """The topics, nodes and edges of normal recordings.

    Attributes
    ----------
    topics : dict of str to TopicTerms
    always, ever : frozenset of str
        Nodes and edges present in every normal recording with graphs, and in any of them.
    paces : dict of str to Pace
        Longest silence, fewest and most messages of a topic in any recording; only for topics that
        have a pace in each recording with that topic.
    constants : dict of str to dict
        Topic -> field that never changes within any recording -> its value as text; None if the
        recordings differ.
    relays : dict of str to dict
        Topic -> source -> lowest share of the topic's messages that are copies of the source's.
    parameters : dict of str to float or str
        Parameter -> its value in all recordings that report it.
    changed : frozenset of str or None
        Parameters that were set during any recording; None if that is unknown.
    repeats : dict of str to dict
        Topic -> number, or `MESSAGES` -> longest sequence that came before in any recording.
    roles : dict of str to tuple of str
        Role -> topics that play it in any recording.
    steady_clock : bool
        Whether the recorder's clock was set back in no recording.
    unsteady : frozenset of str
        Kinds of terms that normal recordings break among themselves, so a breach of one is a note.
    robots : int
        Fewest robots of a recording.
    """

    topics: Mapping[str, TopicTerms]
    always: frozenset[str]
    ever: frozenset[str]
    paces: Mapping[str, Pace] = field(default_factory=dict)
    constants: Mapping[str, Mapping[str, str | None]] = field(default_factory=dict)
    relays: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    roles: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    steady_clock: bool = False
    unsteady: frozenset[str] = frozenset()
    robots: int = 1
    repeats: Repeats = field(default_factory=dict)
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    changed: frozenset[str] | None = None

    @property
    def known(self) -> Known:
        """The topics of the normal recordings, and their roles."""
        return Known(frozenset(self.topics), self.roles)

    @classmethod
    def learned(cls, observations: Sequence[Observation]) -> Self:
        """Return the contract of one or more normal recordings."""
        names = sorted({name for seen in observations for name in seen.topics})
        graphs = [seen.graph for seen in observations if seen.graph is not None]
        measured = merged_paces(seen.paces for seen in observations)
        irregular = {name for seen in observations for name in seen.topics.keys() - seen.paces}
        return cls(
            {name: _terms(name, observations) for name in names},
            frozenset.intersection(*graphs) if graphs else frozenset(),
            frozenset().union(*graphs),
            {name: pace for name, pace in measured.items() if name not in irregular},
            {name: _constants(name, observations) for name in names},
            {name: sources for name in names if (sources := _sources(name, observations))},
            _roles(observations),
            not any(seen.set_back for seen in observations),
            robots=min(seen.robots or 1 for seen in observations),
            repeats={name: usual for name in names if (usual := _repeats(name, observations))},
            parameters=_parameters(observations),
            changed=frozenset().union(*(seen.parameters.changed for seen in observations))
            if len(observations) >= FEWEST_RECORDINGS
            else None,
        )

    def breaches(
        self, seen: Observation, lacking: Mapping[str, str] = NOTHING, *, rates: bool = True
    ) -> list[Breach]:
        """Return the breaches of the contract by a recording: topics first, by name.

        Parameters
        ----------
        seen : Observation
        lacking : mapping of str to str
            Topic -> numbers that all normal recordings have, and this one lacks.
        rates : bool
            Whether to compare rates too; these are of whole recordings.
        """
        found = [
            Breach(name, f"Topic {name} is gone: every normal recording has it.")
            for name, terms in self.topics.items()
            if terms.always and name not in seen.topics
        ]
        for name, (kind, qos, rate_hz) in sorted(seen.topics.items()):
            if (terms := self.topics.get(name)) is None:
                found.append(Breach(name, f"Topic {name} ({kind}) is new."))
            else:
                found += _of_topic(name, terms, kind, qos)
                if rates and seen.whole:
                    found += _of_rate(name, terms, rate_hz, seen.duration_s)
                if kind in terms.types and name in seen.constants:
                    found += self._of_constants(name, seen.constants[name])
                found += self._of_relay(name, seen) if seen.whole else []
                found += self._of_repeats(name, seen.repeats.get(name, {}))
        for at_s, back_s in seen.set_back if self.steady_clock else ():
            when = f"The recorder's clock was set back by {back_s:.3g} s at {at_s:.2f} s"
            found.append(Breach("clock", f"{when}; in no normal recording it was.", "clock"))
        if seen.robots is not None and seen.robots < self.robots:
            has = f"The recording has {seen.robots} of the {self.robots} robots"
            found.append(Breach("robots", f"{has} that every normal recording has.", "robots"))
        found += self._of_parameters(seen.parameters)
        found += self._of_graph(seen.graph)
        for name, numbers in lacking.items():
            if name in seen.topics and seen.topics[name][0] in self.topics[name].types:
                text = f"Topic {name} lacks {numbers}, which all normal recordings have."
                found.append(Breach(name, text, "number"))
        return [_noted(each, _UNSTEADY) if each.term in self.unsteady else each for each in found]

    def broken_terms(self, seen: Observation, lacking: Mapping[str, str] = NOTHING) -> set[str]:
        """Return the kinds of terms in which a recording departs by more than notes."""
        return {each.term for each in self.breaches(seen, lacking) if each.severity == "breach"}

    def breach_of_silence(self, name: str, silent_s: float) -> Breach | None:
        """Return a breach if a topic of a running robot has been silent for too long [s]."""
        pace = self.paces.get(name)
        if pace is None or silent_s <= 2.0 * pace.longest_gap_s + SILENCE_S:
            return None
        usual = f"normal recordings have no silence over {pace.longest_gap_s:.2g} s"
        return Breach(name, f"Topic {name} has been silent for {silent_s:.1f} s; {usual}.")

    def breach_of_count(self, name: str, count: int) -> Breach | None:
        """Return a breach if a topic had too many or too few messages in the last `SPAN_S`."""
        pace = self.paces.get(name)
        if pace is None or pace.fewest is None or pace.most is None:
            return None
        fewest = math.floor(pace.fewest * (1.0 - COUNT_MARGIN)) - 2
        most = math.ceil(pace.most * (1.0 + COUNT_MARGIN)) + 2
        if fewest <= count <= most:
            return None
        usual = f"normal recordings have {pace.fewest} to {pace.most}"
        return Breach(name, f"Topic {name} has {count} messages in {SPAN_S} s; {usual}.")

    def _of_constants(self, name: str, seen: Mapping[str, str]) -> Iterable[Breach]:
        for path, usual in self.constants.get(name, {}).items():
            now = seen.get(path)
            if now is None or (usual is None and now.startswith(LIKE)):
                always = "constant" if usual is None else textwrap.shorten(usual, 40)
                text = f"changes or is missing; in normal recordings it is {always}"
                yield Breach(name, f"Field {path} of topic {name} {text}.", "constant")
            elif usual is not None and (new := _new_value(now, usual)):
                is_rounded = _is_close(new, usual)
                new, usual = (textwrap.shorten(t.removeprefix(LIKE), 40) for t in (new, usual))
                instead = f"is {new} instead of {usual}" if new != usual else "has another value"
                breach = Breach(name, f"Field {path} of topic {name} {instead}.", "constant")
                yield _noted(breach, _ROUNDED) if is_rounded else breach

    def _of_relay(self, name: str, seen: Observation) -> Iterable[Breach]:
        for source, usual in self.relays.get(name, {}).items():
            if self._is_altered(name, source, seen):
                copies = seen.relays[name].get(source)
                share = 0.0 if copies is None else copies.share
                usually = "all" if usual == 1.0 else f"at least {usual:.1%}"
                told = f"messages on topic {name}, {share:.1%} are copies of messages on {source}"
                text = f"Of the {told}; in normal recordings {usually} are."
                breach = Breach(name, text, "copies")
                yield _noted(breach, _FILTERED) if share <= RARE else breach

    def _of_repeats(self, name: str, seen: Mapping[str, int]) -> Iterable[Breach]:
        usual = self.repeats.get(name, {})
        again = [
            number
            for number, longest in seen.items()
            if number in usual and longest >= REPLAYED + REPEATS * usual[number]
        ]
        if again:
            of = "its messages" if MESSAGES in again else join_first(again)
            first = MESSAGES if MESSAGES in again else max(again, key=lambda each: seen[each])
            text = f"repeats {seen[first]} of {of} in a row; in normal recordings at most"
            yield Breach(name, f"Topic {name} {text} {usual[first]}.", "repeats")

    def _is_altered(self, name: str, source: str, seen: Observation) -> bool:
        """Return whether too few messages of a relay are copies of those of its source."""
        usual = self.relays.get(name, {}).get(source)
        if usual is None or name not in seen.relays or source not in seen.topics:
            return False
        copies = seen.relays[name].get(source)
        if copies is None:
            return True
        margin = max(MARGIN, FEW / copies.messages) + self._lost(source, seen)
        return 1.0 - copies.share > 2.0 * (1.0 - usual) + margin

    def _lost(self, name: str, seen: Observation) -> float:
        """Return the share of a topic's usual messages that the recording lacks."""
        usual_hz = self.topics[name].lowest_hz if name in self.topics else None
        rate_hz = seen.topics[name][2]
        return max(0.0, 1.0 - rate_hz / usual_hz) if usual_hz and rate_hz else 0.0

    def _of_parameters(self, seen: ReportedParameters) -> Iterable[Breach]:
        for name, now in sorted(seen.values.items()):
            usual = self.parameters.get(name)
            if usual is not None and now != usual:
                text = f"Parameter {name} is {now} instead of {usual}."
                yield Breach(name, text, "parameter")
            elif self.changed is not None and name in seen.changed - self.changed:
                text = f"Parameter {name} is set to {now}; no normal recording sets it."
                yield Breach(name, text, "parameter")

    def _of_graph(self, graph: frozenset[str] | None) -> list[Breach]:
        if graph is None or not self.ever:
            return []
        changes = [(each, "gone") for each in sorted(self.always - graph)]
        changes += [(each, "new") for each in sorted(graph - self.ever)]
        return [Breach(each, f"{_as_text(each)} is {what}.", "graph") for each, what in changes]

    def to_dict(self) -> dict[str, Any]:
        """Return the contract as JSON-compatible values."""
        document = asdict(self)
        sets = [key for key in _SETS if document[key] is not None]
        return document | {key: sorted(document[key]) for key in sets}

    @classmethod
    def from_dict(cls, document: dict[str, Any]) -> Self:
        """Return the contract from the values of `to_dict`."""
        topics = {
            name: TopicTerms(**terms | {key: tuple(terms[key]) for key in ("types", "qos")})
            for name, terms in document["topics"].items()
        }
        pace_of = {name: Pace(*pace) for name, pace in document["paces"].items()}
        roles = {role: tuple(topics) for role, topics in document["roles"].items()}
        sets = [key for key in _SETS if document.get(key) is not None]  # 0.3.0 has two of them
        return cls(
            **document
            | {key: frozenset(document[key]) for key in sets}
            | {"topics": topics, "paces": pace_of, "roles": roles}
        )


def _terms(name: str, observations: Iterable[Observation]) -> TopicTerms:
    seen = [of.topics.get(name) for of in observations]
    present = [topic for topic in seen if topic is not None]
    rates = [rate for _, _, rate in present if rate is not None]
    steady = len(rates) == len(present) and max(rates) <= STEADY * min(rates)
    return TopicTerms(
        types=tuple(sorted({kind for kind, _, _ in present})),
        qos=tuple(sorted({words for _, qos, _ in present for words in qos})),
        lowest_hz=min(rates) if steady else None,
        highest_hz=max(rates) if steady else None,
        always=len(present) == len(seen),
    )


def _constants(name: str, observations: Iterable[Observation]) -> dict[str, str | None]:
    """Return the fields of a topic that never change within any recording.

    A transform has to be equal in all recordings, too: that of a localisation may rest in each.
    """
    values = _in_all([of.constants[name] for of in observations if name in of.constants])
    return {
        path: usual
        for path, texts in values.items()
        if (usual := _common(texts)) or not (is_of_transform(path) or _changes(texts))
    }


def _common(texts: Sequence[str]) -> str | None:
    """Return the value of a field in all recordings, or few texts that two or more of them have."""
    counts = Counter(like for text in texts for like in likes(text))
    few = LIKE + OR.join(sorted(counts)) if min(counts.values()) > 1 and _changes(texts) else None
    return texts[0] if len(set(texts)) == 1 else few


def _changes(texts: Sequence[str]) -> bool:
    return any(text.startswith(LIKE) for text in texts)


def _new_value(now: str, usual: str) -> str:
    """Return the value of a field, or those of its few texts, that are not usual."""
    if usual.startswith(LIKE):
        return OR.join(sorted(likes(now) - likes(usual)))
    return now if now != usual else ""


def _sources(name: str, observations: Iterable[Observation]) -> dict[str, float]:
    """Return the topics that a topic relays in every recording, and the lowest share of copies."""
    seen = _in_all([of.relays[name] for of in observations if name in of.relays])
    lowest = {source: min(each.share for each in copies) for source, copies in seen.items()}
    return {source: share for source, share in lowest.items() if share >= MOSTLY}


def _repeats(name: str, observations: Iterable[Observation]) -> dict[str, int]:
    """Return what a topic repeats at most in a row, where it differs enough in each recording."""
    seen = _in_all([of.repeats.get(name, {}) for of in observations if name in of.topics])
    return {number: max(lengths) for number, lengths in seen.items()}


def _in_all(seen: Sequence[Mapping[str, T]]) -> dict[str, list[T]]:
    """Return the values of what each of enough recordings has."""
    if len(seen) < FEWEST_RECORDINGS:
        return {}
    keys = [key for key in seen[0] if all(key in each for each in seen)]
    return {key: [each[key] for each in seen] for key in keys}


def _parameters(observations: Sequence[Observation]) -> dict[str, float | str]:
    """Return the parameters that have one value in all recordings that report them."""
    seen = defaultdict[str, list[float | str]](list)
    for of in observations:
        for name, value in of.parameters.values.items():
            seen[name].append(value)
    return {
        name: values[0]
        for name, values in seen.items()
        if len(values) >= FEWEST_RECORDINGS and len(set(values)) == 1
    }


def _roles(observations: Iterable[Observation]) -> dict[str, tuple[str, ...]]:
    """Return the topics that play each role in any recording."""
    found: dict[str, set[str]] = {}
    for seen in observations:
        for role, topics in seen.roles.items():
            found.setdefault(role, set()).update(topics)
    return {role: tuple(sorted(topics)) for role, topics in found.items()}


def _of_topic(name: str, terms: TopicTerms, kind: str, qos: Sequence[str]) -> list[Breach]:
    found = []
    if kind not in terms.types:
        text = f"Topic {name} has type {kind} instead of {' or '.join(terms.types)}."
        found.append(Breach(name, text, "type"))
    if terms.qos and (other := [words for words in qos if words not in terms.qos]):
        text = f"Topic {name} is offered with QoS {other[0]} instead of {' or '.join(terms.qos)}."
        found.append(Breach(name, text, "qos"))
    return found


def _of_rate(name: str, terms: TopicTerms, rate_hz: float | None, span_s: float) -> list[Breach]:
    if terms.lowest_hz is None or terms.highest_hz is None:
        return []
    spread_hz = terms.highest_hz - terms.lowest_hz + FEW / span_s
    lowest_hz = terms.lowest_hz * (1.0 - MARGIN) - spread_hz
    highest_hz = terms.highest_hz * (1.0 + MARGIN) + spread_hz
    too_few = rate_hz is None and lowest_hz * span_s < FEWEST
    if too_few or lowest_hz <= (rate_hz or 0.0) <= highest_hz:
        return []
    usual = " to ".join(dict.fromkeys(f"{hz:.3g}" for hz in (terms.lowest_hz, terms.highest_hz)))
    text = f"Topic {name} has {rate_hz or 0.0:.3g} Hz instead of {usual} Hz."
    breach = Breach(name, text, "rate")
    if rate_hz and terms.lowest_hz / STEADY <= rate_hz <= terms.highest_hz * STEADY:
        return [_noted(breach, _OTHER_MACHINE)]
    return [breach]


def _noted(breach: Breach, reason: str) -> Breach:
    """Return a breach as a note, unless it is one already."""
    if breach.severity == "note":
        return breach
    text = f"{breach.text} This is a note, no breach: {reason}."
    return breach._replace(text=text, severity="note")


def _is_close(text: str, usual: str) -> bool:
    """Return whether two values, as text, are equal numbers but for rounding.

    Examples
    --------
    >>> _is_close("[0.12, 3.5]", "[0.12000001, 3.5]"), _is_close("'base'", "'base_link'")
    (True, False)
    """
    if _NUMBER.sub("", text) != _NUMBER.sub("", usual):
        return False
    numbers, others = (np.array(_NUMBER.findall(each), dtype=np.float64) for each in (text, usual))
    return bool(np.allclose(numbers, others, rtol=ROUNDED, atol=0.0))


def _rate(count: int, duration_s: float) -> float | None:
    return count / duration_s if count >= FEWEST and duration_s > 0.0 else None


def graph_elements(graph: RosGraph) -> frozenset[str]:
    """Return nodes and edges, with process suffixes replaced by ``*``."""
    name = {vertex: PROCESS_SUFFIX.sub("*", vertex) for vertex in graph}
    nodes = {name[vertex] for vertex, data in graph.nodes(data=True) if data["kind"] == "node"}
    return frozenset(
        nodes | {f"{name[source]} -> {name[target]}" for source, target in graph.edges}
    )


def _as_text(element: str) -> str:
    """Return an element of the graph as text.

    Examples
    --------
    >>> _as_text("node:/amcl")
    'Node /amcl'
    >>> _as_text("node:/amcl -> topic:/tf")
    'The publisher of /tf in node /amcl'
    >>> _as_text("topic:/scan -> node:/amcl")
    'The subscription to /scan in node /amcl'
    """
    source, _, target = element.partition(" -> ")
    if not target:
        return f"Node {source.partition(':')[2]}"
    kinds, names = zip(*(end.split(":", 1) for end in (source, target)), strict=True)
    if kinds[0] == "node":
        return f"The publisher of {names[1]} in node {names[0]}"
    return f"The subscription to {names[0]} in node {names[1]}"


def qos_words(profiles: Iterable[Qos]) -> tuple[str, ...]:
    """Return profiles as text, such as ``reliable, transient local``."""
    words = {
        f"{profile.reliability.name}, {profile.durability.name}".lower().replace("_", " ")
        for profile in profiles
    }
    return tuple(sorted(words))
