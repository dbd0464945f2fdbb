"""Finds topics whose messages are copies of those of another topic.

A relay, a multiplexer or a filter that lets messages pass republishes the same bytes. A program
that alters messages on the way leaves them similar, and few features compare topics of any type.
"""

from array import array
from collections import defaultdict
from collections.abc import Mapping
from itertools import accumulate
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from oracle_pipeline.bags.merging import Messages, Rows
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.scoring.pace import FEWEST

MOST_TOPICS = 500  # of a type that are compared
MOST_MESSAGES = 1_000_000  # of all topics that are compared; types with few messages come first


class Copies(NamedTuple):
    """How many messages of a topic are equal to a message of another one."""

    equal: int
    messages: int

    @property
    def share(self) -> float:
        """Share of the topic's messages."""
        return self.equal / self.messages


Relays: TypeAlias = Mapping[str, Mapping[str, Copies]]


class Fingerprints:
    """Hashes of the messages of topics that share their type, taken while the bag is read.

    Parameters
    ----------
    bag : BagReader
        The bag that is read.
    """

    def __init__(self, bag: BagReader) -> None:
        self._names = list(bag.topics)
        of_type = defaultdict(list)
        for number, topic in enumerate(bag.topics.values()):
            if topic.count:
                of_type[topic.msgtype].append(number)
        groups = [numbers for numbers in of_type.values() if 1 < len(numbers) <= MOST_TOPICS]
        counts = [topic.count for topic in bag.topics.values()]
        sizes = [sum(counts[number] for number in numbers) for numbers in groups]
        order = sorted(range(len(groups)), key=sizes.__getitem__)
        totals = accumulate(sizes[place] for place in order)
        self._groups = [
            groups[place]
            for place, total in zip(order, totals, strict=True)
            if total <= MOST_MESSAGES
        ]
        self._hashes = {number: array("q") for numbers in self._groups for number in numbers}
        self._times = {number: array("q") for number in self._hashes}

    def add(self, batch: Messages, number: int, rows: Rows) -> None:
        """Take the hashes of the next messages of a topic: some rows of a batch."""
        if (hashes := self._hashes.get(number)) is not None:
            hashes.extend(map(hash, batch.messages(rows)))
            self._times[number].extend(batch.stamps_ns[rows].tolist())

    def relays(self) -> dict[str, dict[str, Copies]]:
        """Return the topics that can be relays, and their copies: topic -> source -> copies.

        A copy comes after its source. A topic without any copy has an empty entry. A topic
        with fewer than `FEWEST` different messages has none, because these may be equal by chance.
        """
        found: dict[str, dict[str, Copies]] = {}
        for numbers in self._groups:
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

    def _follows(self, topic: int, source: int) -> bool:
        """Return whether what two topics share came on the source first; of two at once, one is."""
        ours, theirs = (  # of equal messages, the time of the first is set last
            dict(zip(reversed(self._hashes[each]), reversed(self._times[each]), strict=True))
            for each in (topic, source)
        )
        later = float(np.median([ours[key] - theirs[key] for key in ours.keys() & theirs]))
        return later > 0.0 or (later == 0.0 and self._names[source] < self._names[topic])


def _occurrences(hashes: "list[array[int]]") -> "csr_array[np.int64]":
    """Return how often each topic has each message, shape (n_topics, n_different)."""
    topic = np.repeat(np.arange(len(hashes)), [len(each) for each in hashes])
    values = np.concatenate([np.frombuffer(each, dtype=np.int64) for each in hashes])
    different, message = np.unique(values, return_inverse=True)
    ones: NDArray[np.int64] = np.ones(len(values), dtype=np.int64)
    return csr_array((ones, (topic, message)), shape=(len(hashes), len(different)))
