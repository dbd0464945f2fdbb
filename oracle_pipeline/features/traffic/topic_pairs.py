"""Differences of two topics of one type, such as redundant sensors, or a topic and its relay.

Only messages with an array of floating-point numbers can be compared. An array is compared with
the one on the other topic that was recorded closest in time, index by index. Sensors that look
elsewhere always differ, and an attack on one changes that difference. Of a type with more than 20
topics, each is compared with the few that look most alike. ``redundancy`` uses the mounts of
sensors.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations, groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.statistics.arrays import (
    ARRAYS,
    STATISTICS,
    doubled_ranks,
    each,
    standardised,
    statistics_of_topics,
)
from oracle_pipeline.features.statistics.reduction import largest, mean, quantile, smallest, within

FEATURES = (
    fp.Feature(
        "rank_difference_max", "1", 5e-3,
        "1 - Spearman's correlation between the arrays of two topics, mean, maximum over the pairs",
    ),
    fp.Feature(
        "rank_difference_min", "1", 5e-3,
        "1 - Spearman's correlation between the arrays of two topics, mean, minimum over the pairs",
    ),
    fp.Feature("histogram_distance", "1", 2e-3,
        "Wasserstein-1 distance between the numbers of two topics, over the range of all numbers "
        "of the type, maximum over the pairs"),
    fp.Feature(
        "roughness_ratio", "1", 0.3, "abs(ln) of two topics' ratio of median roughness, maximum"
    ),
    *fp.timed(
        fp.Feature("rate_ratio", "1", 0.05, "abs(ln) of two topics' ratio of messages, maximum")
    ),
    fp.Feature("identity", "1", 0.01, "share of arrays that are equal on two topics, maximum",
        shortcut=True),
)  # fmt: skip

_ALL_COMPARED = 20  # most topics of a type of which all pairs are compared
_NEIGHBOURS = 4  # topics that each is compared with if there are more
_APART_S = 0.1  # most time between two compared arrays
_BINS = 128
_LOOKED_AT = 100  # arrays of a topic, about, to find the range of its numbers
_TAILS = (1e-3, 1.0 - 1e-3)  # quantiles at the ends of the histograms


class _Counts(NamedTuple):
    """Cumulative histograms of the numbers in arrays."""

    times_s: NDArray[np.float64]  # shape (n,), of the arrays
    before: NDArray[np.int32]  # shape (n + 1, _BINS): in each bin, in all arrays before the i-th

    def shares_up_to(self, window: fp.Window) -> NDArray[np.float64]:
        """Return the share of a window's numbers up to each bin, shape (_BINS,); NaN if none."""
        arrays = within(self.times_s, window)
        counts = np.cumsum(self.before[arrays.stop] - self.before[arrays.start])
        return counts / counts[-1] if counts[-1] else np.full(_BINS, np.nan)


@dataclass(frozen=True, slots=True)
class _Prepared:
    """Statistics of all arrays, and comparisons with their counterparts."""

    pairs: dict[str, tuple[str, str]]  # topics, by the pair's name
    rank_difference: dict[str, fp.Series]  # by pair, as is identity
    identity: dict[str, fp.Series]
    roughness: dict[str, fp.Series]  # by topic, as are the counts
    counts: dict[str, _Counts]


def prepare(window: fp.Window) -> _Prepared | fp.Missing:
    """Reduce the arrays of topics of which there are several of one type."""
    prepared = _Prepared({}, {}, {}, {}, {})
    for group in _groups(window):
        low, high = _range(list(group.values()))
        ranks = {}
        for topic, (times_s, arrays) in group.items():
            ranks[topic] = np.empty(len(arrays), dtype=object)
            ranks[topic][:] = each(doubled_ranks, arrays)
            rough = statistics_of_topics(window)[topic].values[:, STATISTICS.index("roughness")]
            prepared.roughness[topic] = fp.Series(times_s, np.ascontiguousarray(rough))
            prepared.counts[topic] = _counts(times_s, arrays, low, high)
        for a, b in _compared(group):
            pair = f"{a} against {b}"
            times_s, ours, theirs = _met(group[a], group[b])
            prepared.pairs[pair] = a, b
            prepared.rank_difference[pair] = fp.Series(
                times_s, np.array(each(_rank_differences, ranks[a][ours], ranks[b][theirs]))
            )
            met = group[a].values[ours], group[b].values[theirs]
            prepared.identity[pair] = fp.Series(
                times_s, np.array(each(_identities, *met), np.float64)
            )
    return prepared if prepared.pairs else fp.Missing("no two topics of the same type have arrays")


def compute(window: fp.Window) -> fp.Values:
    """Reduce to the window, and to the pair that differs most."""
    prepared: _Prepared = window.prepared
    pairs = prepared.pairs.items()
    rough = {topic: quantile(series, window, 0.5) for topic, series in prepared.roughness.items()}
    shares = {topic: counts.shares_up_to(window) for topic, counts in prepared.counts.items()}
    number = {topic: len(window.arrivals[topic].times_s) for topic in prepared.counts}
    distance = {pair: float(np.abs(shares[a] - shares[b]).mean()) for pair, (a, b) in pairs}
    difference = {p: mean(series, window) for p, series in prepared.rank_difference.items()}
    identity = {pair: mean(series, window) for pair, series in prepared.identity.items()}
    apart = f"no two arrays within {_APART_S} s of each other"
    silent = "one topic of each pair has no messages"
    return {
        "rank_difference_max": largest(difference, apart),
        "rank_difference_min": smallest(difference, apart),
        "histogram_distance": largest(distance, silent),
        "roughness_ratio": largest(
            {pair: _log_ratio(rough[a], rough[b]) for pair, (a, b) in pairs},
            "one topic of each pair has no array with a roughness above 0",
        ),
        "rate_ratio": largest(
            {pair: _log_ratio(number[a], number[b]) for pair, (a, b) in pairs}, silent
        ),
        "identity": largest(identity, apart),
    }


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of pairs of topics."""
    topics = {"arrays": ARRAYS}
    return [fp.FeaturePlugin("pairs", "pairs", FEATURES, compute, topics, prepare=prepare)]


def _groups(window: fp.Window) -> Iterator[dict[str, fp.Series]]:
    """Yield the topics with arrays, by type, where there are two or more of one."""
    arrays = window.topics["arrays"]
    msgtypes = {topic: window.arrivals[topic].msgtype for topic in arrays}
    by_type = sorted(arrays, key=lambda topic: (msgtypes[topic], topic))
    for _, topics in groupby(by_type, msgtypes.__getitem__):
        group = {topic: arrays[topic] for topic in topics}
        if len(group) > 1:
            yield group


def _compared(group: Mapping[str, fp.Series]) -> Iterator[tuple[str, str]]:
    """Yield the pairs of topics to compare: all, or of many topics the most similar ones."""
    if len(group) <= _ALL_COMPARED:
        yield from combinations(group, 2)
        return
    alike = sorted(group, key=lambda topic: (*_look(group[topic]), topic))
    for place, topic in enumerate(alike):
        for other in alike[place + 1 : place + 1 + _NEIGHBOURS]:
            yield min(topic, other), max(topic, other)


def _look(series: fp.Series) -> tuple[float, ...]:
    """Return the length of a topic's arrays, their number, and the content of the first."""
    first = series.values[0].astype(np.float64)
    finite = first[np.isfinite(first)]
    return (
        float(np.median([array.size for array in series.values])), len(series.values),
        float(finite.mean()) if finite.size else 0.0,
    )  # fmt: skip


def _range(group: list[fp.Series]) -> tuple[float, float]:
    """Return the range of the numbers on some topics, without their tails."""
    some = [array for s in group for array in s.values[:: 1 + len(s.values) // _LOOKED_AT]]
    numbers = np.concatenate(some, dtype=np.float64)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return 0.0, 1.0
    low, high = np.quantile(numbers, _TAILS)
    return float(low), float(high) if high > low else float(low) + 1.0


def _counts(
    times_s: NDArray[np.float64], arrays: NDArray[np.object_], low: float, high: float
) -> _Counts:
    before = np.zeros((len(arrays) + 1, _BINS), dtype=np.int32)
    for row, array in enumerate(arrays):
        before[row + 1] = before[row]
        _count(array, low, _BINS / (high - low), before[row + 1])
    return _Counts(times_s, before)


@jit
def _count(
    numbers: NDArray[np.floating[Any]], low: float, per_unit: float, counts: NDArray[np.int32]
) -> None:
    """Add the finite numbers of an array to a histogram, those beyond it to its ends."""
    for number in numbers:
        if np.isfinite(number):
            place = (np.float64(number) - low) * per_unit
            counts[int(min(max(place, 0.0), len(counts) - 1.0))] += 1


def _rank_differences(ours: NDArray[np.uint16], theirs: NDArray[np.uint16]) -> list[float]:
    both = zip(standardised(ours), standardised(theirs), strict=True)
    return [max(0.0, 1.0 - float(a @ b)) for a, b in both]


def _identities(ours: NDArray[Any], theirs: NDArray[Any]) -> NDArray[np.bool_]:
    same: NDArray[np.bool_] = ((ours == theirs) | (np.isnan(ours) & np.isnan(theirs))).all(axis=1)
    return same


def _met(
    ours: fp.Series, theirs: fp.Series
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the times of the first topic's arrays with a counterpart, and the numbers of both."""
    after = np.searchsorted(theirs.times_s, ours.times_s)
    either = np.stack([np.maximum(after - 1, 0), np.minimum(after, len(theirs.times_s) - 1)])
    apart_s = np.abs(theirs.times_s[either] - ours.times_s)
    nearest = np.where(apart_s[0] <= apart_s[1], *either)
    equally_long = np.array(
        [a.size == b.size for a, b in zip(ours.values, theirs.values[nearest], strict=True)]
    )
    met = np.flatnonzero((apart_s.min(axis=0) <= _APART_S) & equally_long)
    return ours.times_s[met], met, nearest[met]


def _log_ratio(a: float, b: float) -> float:
    """Return abs(ln(a / b)); NaN unless both are positive."""
    return float(abs(np.log(a / b))) if a > 0.0 and b > 0.0 else np.nan
