"""Finds equal messages: topics that copy another one, and topics that repeat themselves.

A relay, a multiplexer or a filter that lets messages pass republishes what it receives. A program
that alters messages on the way leaves them similar, and few features compare topics of any type.

Noise makes the messages of a sensor differ, and each number in them. A sequence of them that comes
again was recorded and replayed, even if it fits what else happens.
"""

from array import array
from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from oracle_pipeline.bags.merging import Messages, Rows
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import typestore
from oracle_pipeline.features.engine.message_layout import MessageLayout, has_header
from oracle_pipeline.features.signals.collector import PERIOD, Signals
from oracle_pipeline.scoring.pace import FEWEST

MOST_TOPICS = 500  # of a type that are compared
MOST_MESSAGES = 1_000_000  # of a topic, and of all topics of a type, that are compared
MESSAGES = ""  # stands for whole messages, where others are names of numbers
RECENT = 10_000  # different messages that a topic of a running robot is compared with
DIFFERENT = 50  # messages or numbers that must differ; states and texts repeat by themselves
ROUNDING = 8  # spacings of floats at the largest value; smaller differences are rounding errors
FINE = 10  # of a number whose steps vary: median over least difference between two steps
_STAMP_ENDS = 12  # bytes of a message up to the end of its header's stamp


class Copies(NamedTuple):
    """How many messages of a topic are equal to a message of another one."""

    equal: int
    messages: int

    @property
    def share(self) -> float:
        """Share of the topic's messages."""
        return self.equal / self.messages


Relays: TypeAlias = Mapping[str, Mapping[str, Copies]]
Repeats: TypeAlias = Mapping[str, Mapping[str, int]]


class Fingerprints:
    """Hashes of messages, without the stamps of their headers, taken while the bag is read.

    Parameters
    ----------
    bag : BagReader
        The bag that is read.
    """

    def __init__(self, bag: BagReader) -> None:
        self._bag = bag
        self._names = list(bag.topics)
        topics = enumerate(bag.topics.values())
        self._hashes = {n: array("q") for n, of in topics if 0 < of.count <= MOST_MESSAGES}
        self._times = {number: array("q") for number in self._hashes}
        self._begins = {
            number: _STAMP_ENDS if MessageLayout(bag, self._names[number]).has_header else 0
            for number in self._hashes
        }

    def add(self, batch: Messages, number: int, rows: Rows) -> None:
        """Take the hashes of the next messages of a topic: some rows of a batch."""
        if (hashes := self._hashes.get(number)) is not None:
            begin = self._begins[number]
            hashes.extend(hash(data[begin:]) for data in batch.messages(rows))
            self._times[number].extend(batch.stamps_ns[rows].tolist())

    def relays(self) -> dict[str, dict[str, Copies]]:
        """Return the topics that can be relays, and their copies: topic -> source -> copies.

        A copy comes after its source. A topic without any copy has an empty entry. A topic
        with fewer than `FEWEST` different messages has none, because these may be equal by chance.
        """
        found: dict[str, dict[str, Copies]] = {}
        for numbers in self._of_one_type():
            counts = _occurrences([self._hashes[number] for number in numbers])
            equal = (counts @ (counts > 0).astype(np.int64).T).toarray()
            for row, number in enumerate(numbers):
                if counts.indptr[row + 1] - counts.indptr[row] >= FEWEST:
                    count = int(equal[row, row])
                    found[self._names[number]] = {
                        self._names[other]: Copies(int(equal[row, column]), count)
                        for column, other in enumerate(numbers)
                        if other != number and equal[row, column] and self._follows(number, other)
                    }
        return found

    def repeats(self, signals: Iterable[Signals]) -> dict[str, dict[str, int]]:
        """Return what repeats how much in a row, if it varies enough: topic -> number -> length.

        Parameters
        ----------
        signals : iterable of Signals
            Of the bag.
        """
        found = defaultdict[str, dict[str, int]](dict)
        for number, hashes in self._hashes.items():
            if len(set(hashes)) >= DIFFERENT:
                found[self._names[number]][MESSAGES] = len(longest_repeat(hashes))
        for each, name, rows in repeated_numbers(signals):
            found[each.topic][name] = len(rows)
        return dict(found)

    def _of_one_type(self) -> Iterator[list[int]]:
        """Yield the topics of each type that has several."""
        of_type = defaultdict(list)
        for number in self._hashes:
            of_type[self._bag.topics[self._names[number]].msgtype].append(number)
        for numbers in of_type.values():
            messages = sum(len(self._hashes[number]) for number in numbers)
            if 1 < len(numbers) <= MOST_TOPICS and messages <= MOST_MESSAGES:
                yield numbers

    def _follows(self, topic: int, source: int) -> bool:
        """Return whether what two topics share came on the source first; of two at once, one is."""
        ours, theirs = (  # of equal messages, the time of the first is set last
            dict(zip(reversed(self._hashes[each]), reversed(self._times[each]), strict=True))
            for each in (topic, source)
        )
        later = float(np.median([ours[key] - theirs[key] for key in ours.keys() & theirs]))
        return later > 0.0 or (later == 0.0 and self._names[source] < self._names[topic])


class RecentRepeats:
    """Finds what `longest_repeat` does, message by message, on a topic of a running robot.

    Parameters
    ----------
    msgtype : str
        Of its messages.
    """

    def __init__(self, msgtype: str) -> None:
        self._begin = _STAMP_ENDS if has_header(typestore(), msgtype) else 0
        self._places = OrderedDict[int, int]()  # by hash: the last place of each recent message
        self._place = 0  # of the newest message; equal ones in a row have the same
        self._earlier = -2  # place of the one that the last repeated message repeats
        self._length = self._most = 0  # of the sequence that it continues

    def add(self, message: bytes) -> int:
        """Take the next message; return the length of the repeat that it continues, or 0."""
        content = hash(message[self._begin :])
        earlier = self._places.pop(content, -1)
        self._place += earlier != self._place
        self._places[content] = self._place  # as the newest
        if len(self._places) > RECENT:
            self._places.popitem(last=False)
        if earlier in (-1, self._place):  # new, or as the message before
            return 0
        if earlier != self._earlier + 1:
            self._length, self._most = 0, self._place - earlier
        self._earlier = earlier
        self._length = min(self._length + 1, self._most)
        return self._length if len(self._places) >= DIFFERENT else 0


def repeated_numbers(signals: Iterable[Signals]) -> Iterator[tuple[Signals, str, Rows]]:
    """Yield each number that varies enough: where it is, its name, and the rows that it repeats."""
    for each in signals:
        for name, values in zip(each.names, each.values.T, strict=True):
            if name != PERIOD and _varies(values):
                yield each, name, longest_repeat(values)


def _varies(values: NDArray[np.float64]) -> bool:
    """Return whether enough values differ, and their steps; rounded ones and ramps come again."""
    values = values[np.isfinite(values)]
    if len(np.unique(values)) < DIFFERENT:
        return False
    steps = np.abs(np.diff(values, n=2))
    steps = steps[steps > ROUNDING * np.spacing(np.abs(values).max())]
    return len(steps) > 0 and bool(np.median(steps) >= FINE * steps.min())


def longest_repeat(contents: ArrayLike) -> Rows:
    """Return the rows of the longest sequence that repeats the one at some earlier place.

    Equal messages in a row count once. What is between the repeated messages does not end a
    sequence, and no sequence repeats itself, as two states that alternate would.

    Parameters
    ----------
    contents : array_like of shape (n,)
        Numbers, or one for each message, where equal ones stand for equal messages.

    Examples
    --------
    >>> longest_repeat([1, 2, 3, 4, 9, 2, 3, 8, 4, 5]), longest_repeat([1, 2, 1, 2, 1, 2])
    (array([5, 6, 8]), array([2, 3]))
    """
    values = np.asarray(contents)
    rows = np.delete(np.arange(len(values)), np.flatnonzero(values[1:] == values[:-1]))
    values = values[rows]
    order = np.argsort(values, kind="stable")
    again = values[order[1:]] == values[order[:-1]]
    earlier = np.full(len(values), -1)
    earlier[order[1:][again]] = order[:-1][again]
    (repeated,) = np.nonzero(earlier >= 0)
    earlier = earlier[repeated]
    (begins,) = np.nonzero(np.diff(earlier, prepend=-2) != 1)
    lengths = np.minimum(np.diff(begins, append=len(repeated)), (repeated - earlier)[begins])
    if not len(lengths):
        return rows[:0]
    best = lengths.argmax()
    return rows[repeated[begins[best] : begins[best] + lengths[best]]]


def _occurrences(hashes: "list[array[int]]") -> "csr_array[np.int64]":
    """Return how often each topic has each message, shape (n_topics, n_different)."""
    topic = np.repeat(np.arange(len(hashes)), [len(each) for each in hashes])
    values = np.concatenate([np.frombuffer(each, dtype=np.int64) for each in hashes])
    different, message = np.unique(values, return_inverse=True)
    ones: NDArray[np.int64] = np.ones(len(values), dtype=np.int64)
    return csr_array((ones, (topic, message)), shape=(len(hashes), len(different)))
