"""What a check sees of a recording, one topic at a time, and what it returns."""

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine.kept_messages import NO_GRAPH, KeptMessages
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.signals.collector import SignalCollector, Signals
from oracle_pipeline.features.signals.fields import sequences

Floats = NDArray[np.float64]

_LIVELY_SHARE = 0.8  # of a signal's numbers differ from the one before: it has noise, or moves
_COMMAND = re.compile("(?i)cmd|command|setpoint|actuator|joy|ackermann|/Twist(Stamped)?$")
FEWEST = 50  # messages; of fewer, nothing is known about what is usual


class Fault(NamedTuple):
    """Something that a check found in a topic, at its worst place."""

    check: str  # such as "gap"
    topic: str  # empty: all topics
    signal: str  # field of the message; empty: the topic as a whole
    start_s: float  # since the start of the recording
    end_s: float
    size: float  # how large it is, in the unit
    unit: str
    places: int  # number of places like this one in the topic
    text: str  # a sentence for people


@dataclass(frozen=True, slots=True)
class CheckedTopic:
    """The messages of one topic.

    Attributes
    ----------
    name, msgtype : str
    times_s : ndarray of shape (n,)
        When messages were recorded, since the start of the recording, ascending.
    stamps_ns : ndarray of shape (n,) or (0,)
        Stamps in the headers; none if the type has no header.
    signals : tuple of Signals
        The numbers in the messages.
    """

    name: str
    msgtype: str
    times_s: Floats
    stamps_ns: NDArray[np.int64]
    signals: tuple[Signals, ...]

    @property
    def is_command(self) -> bool:
        """Whether it is sent on demand, and may leave values open, as PX4 does by NaN."""
        return _COMMAND.search(f"{self.name} {self.msgtype}") is not None


class CheckedSignal(NamedTuple):
    """One number of the messages of a topic, over time."""

    name: str
    unit: str
    times_s: Floats
    values: Floats  # finite or not

    @property
    def is_lively(self) -> bool:
        """Whether it nearly always differs from its last number, as measurements do."""
        finite = self.values[np.isfinite(self.values)]
        return len(finite) >= FEWEST and float(np.mean(np.diff(finite) != 0.0)) >= _LIVELY_SHARE


def topics_of(recording: KeptMessages, collector: SignalCollector) -> list[CheckedTopic]:
    """Return the topics of a recording whose messages a collector has seen."""
    window = recording.span(Span(0, recording.clock.duration_ns), NO_GRAPH)
    by_topic: dict[str, list[Signals]] = {}
    for signals in collector.signals(recording.times_ns):
        by_topic.setdefault(signals.topic, []).append(signals)
    return [
        CheckedTopic(
            name, arrivals.msgtype, arrivals.times_s, arrivals.header_stamps_ns,
            tuple(by_topic.get(name, ())),
        )
        for name, arrivals in window.arrivals.items()
    ]  # fmt: skip


def signals_of(topic: CheckedTopic) -> list[CheckedSignal]:
    """Return the numbers of a topic one by one, without the means over sequences of messages."""
    found = []
    for signals in topic.signals:
        times_s = np.asarray(signals.times_ns / 1e9, dtype=np.float64)
        named = zip(signals.names, signals.units, signals.values.T, strict=True)
        found += [CheckedSignal(name, unit, times_s, values) for name, unit, values in named]
    means = sequences(signal.name for signal in found)
    return [signal for signal in found if not signal.name.startswith(means)]


def step_spans(times_s: Floats, steps: NDArray[np.int64]) -> Floats:
    """Return the times between which steps lie, shape (n, 2)."""
    return np.column_stack([times_s[steps], times_s[steps + 1]])


def worst(
    check: str, topic: str, signal: str, spans: NDArray[np.float64], sizes: Floats, unit: str,
    text: str,
) -> Fault:  # fmt: skip
    """Return one fault for all places of a kind: the largest, and how many there are.

    Parameters
    ----------
    spans : ndarray of shape (n_places, 2)
        Where each begins and ends [s].
    sizes : ndarray of shape (n_places,)
        How large each is.
    text : str
        For people; it may name ``{size}``, ``{at}`` and ``{count}``.
    """
    place = int(np.argmax(np.abs(sizes)))
    start_s, end_s, size = float(spans[place, 0]), float(spans[place, 1]), float(sizes[place])
    sentence = text.format(size=f"{size:.4g}", at=f"{start_s:.2f} s", count=len(sizes))
    return Fault(check, topic, signal, start_s, end_s, size, unit, len(sizes), sentence)


def runs(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the stretches in which a mask is true, shape (n, 2): first, and one after the last.

    Examples
    --------
    >>> runs(np.array([False, True, True, False, True])).tolist()
    [[1, 3], [4, 5]]
    """
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)])
