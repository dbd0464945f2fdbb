"""Measures how regularly the messages of a topic arrive, from their stamps alone.

`oracle watch` compares a running robot with it: it reports a silence longer than any in normal
recordings, and an unusual number of messages in ten seconds.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.reader import BagReader

SPAN_S = 10  # over which messages are counted [s]
FEWEST = 10  # messages of a topic; with fewer (for example latched topics) it has no pace
_SECOND_NS = 1_000_000_000


class Stamped(NamedTuple):
    """The topics and stamps of some messages; shape (n,) each."""

    topics: NDArray[np.int16]  # numbers, in the order of the bag's topics
    stamps_ns: NDArray[np.int64]


class Pace(NamedTuple):
    """The pace of a topic, measured from its first message."""

    longest_gap_s: float  # without a message, up to the end of the recording [s]
    fewest: int | None  # messages in any span of `SPAN_S`; None if all recordings are shorter
    most: int | None

    @classmethod
    def of(cls, stamps_ns: NDArray[np.int64], end_ns: int) -> "Pace":
        """Return the pace of the messages of one topic.

        Parameters
        ----------
        stamps_ns : ndarray of shape (n_messages,)
            Ascending; at least one.
        end_ns : int
            When the recording ended.

        Examples
        --------
        >>> Pace.of(np.arange(0, 20, 2, dtype=np.int64) * 10**9, 25 * 10**9)
        Pace(longest_gap_s=7.0, fewest=2, most=5)
        """
        gaps_ns = np.diff(stamps_ns, append=end_ns)
        first_end = int(stamps_ns[0]) + SPAN_S * _SECOND_NS
        seconds = max(0, (end_ns - first_end) // _SECOND_NS + 1)  # as live: once a second
        looks = np.arange(min(seconds, (SPAN_S + 2) * len(stamps_ns)))
        if len(looks) < seconds:  # after a clock jump: counts change only near a message
            after = np.arange(SPAN_S + 2)
            looks = np.unique(((stamps_ns - first_end) // _SECOND_NS)[:, np.newaxis] + after)
            looks = looks[(looks >= 0) & (looks < seconds)]
        ends = first_end + looks * _SECOND_NS
        counts = np.subtract(
            *(np.searchsorted(stamps_ns, each) for each in (ends, ends - SPAN_S * _SECOND_NS))
        )
        return cls(
            max(0.0, float(gaps_ns.max()) / _SECOND_NS),
            int(counts.min()) if len(counts) else None,
            int(counts.max()) if len(counts) else None,
        )


def paces(bag: BagReader, messages: Sequence[Stamped]) -> dict[str, Pace]:
    """Return the pace of each topic of a bag with at least `FEWEST` messages.

    Parameters
    ----------
    bag : BagReader
    messages : sequence of Stamped
        All messages of the bag, by batch.
    """
    if not messages:
        return {}
    topics, stamps_ns = (np.concatenate(column) for column in zip(*messages, strict=True))
    order = np.lexsort((stamps_ns, topics))
    topics, stamps_ns = topics[order], stamps_ns[order]
    names = list(bag.topics)
    present, begins = np.unique(topics, return_index=True)
    return {
        names[number]: Pace.of(own_ns, bag.end_ns)
        for number, own_ns in zip(present, np.split(stamps_ns, begins[1:]), strict=True)
        if len(own_ns) >= FEWEST
    }


def merged_paces(seen: Iterable[Mapping[str, Pace]]) -> dict[str, Pace]:
    """Return the widest pace of each topic over all recordings."""
    merged: dict[str, Pace] = {}
    for pace_of in seen:
        for name, pace in pace_of.items():
            known = merged.get(name, pace)
            fewest = [each.fewest for each in (known, pace) if each.fewest is not None]
            most = [each.most for each in (known, pace) if each.most is not None]
            merged[name] = Pace(
                max(known.longest_gap_s, pace.longest_gap_s),
                min(fewest, default=None),
                max(most, default=None),
            )
    return merged
