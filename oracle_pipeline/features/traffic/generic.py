"""Features of any bag: arrival times of messages, and statistics of their bytes.

Topics differ between systems, but columns must not. Each number is computed for every topic, and
the table has the largest (with its topic), the smallest and the mean. Features that compare topics
of one type are in ``topic_pairs``.
"""

import math
import zlib
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.statistics.arrays import ARRAYS, STATISTICS, statistics_of_topics
from oracle_pipeline.features.statistics.reduction import (
    column_medians,
    largest,
    median_and_deviation,
    smallest,
    within,
)

_FEWEST = 20  # messages of a steady topic
_STEADY_JITTER = 0.2  # largest jitter of a steady topic
_USUAL_SHARE = 0.05  # of a rate, which a queue or another machine loses
_STEADY_SHARE = 0.9  # of the recording, which its messages cover at their median period

_SAMPLED_S = 2.5  # between the sampled messages
_SHORTEST, _LONGEST = 256, 2048  # bytes: shortest sampled message, and how much of one is used
_STRIDE = 8  # bytes between compared numbers: one of 64 bits, or two of 32

_OVER_TOPICS = {"max": "maximum", "min": "minimum", "mean": "mean"}  # over topics


def _features(
    name: str, unit: str, floor: float, description: str, *, per_window: bool = True
) -> Iterator[fp.Feature]:
    for reduction, words in _OVER_TOPICS.items():
        told = f"{description}, {words} over topics"
        yield fp.Feature(f"{name}_{reduction}", unit, floor, told, per_window=per_window)


_TIMING_FEATURES = fp.timed(
    fp.Feature("message_rate", "1/s", 1.0, "messages of all topics per second", share=_USUAL_SHARE),
    fp.Feature("byte_rate", "B/s", 100.0, "bytes of all topics per second", share=_USUAL_SHARE),
    fp.Feature("silent_topics", "1", 0.01, "share of the topics without messages"),
    fp.Feature("steady_topics", "1", 0.05,
        f"share of the topics with {_FEWEST} messages that publish at a steady rate from start to "
        "end", per_window=False, extensive=True),
    *_features(
        "jitter", "1", 0.05,
        "median absolute deviation of the time between messages over its median, steady topics",
        per_window=False,
    ),
    fp.Feature("gap_max", "1", 1.0,
        "longest time between messages over the topic's median, maximum over the steady topics",
        per_window=False, extensive=True),
    fp.Feature("out_of_order_max", "1", 0.05,
        "share of header stamps earlier than the previous message's, maximum over topics"),
)  # fmt: skip

_BYTE_FEATURES = (
    *_features("byte_entropy", "bit", 0.02, "entropy of the differences of bytes 8 apart, median"),
    *_features("zlib_ratio", "1", 2e-3, "zlib ratio of the differences of bytes 8 apart, median"),
)

# Rounding to the resolution of a sensor makes numbers of an array equal.
_ARRAY_FEATURES = (
    *_features("non_finite", "1", 1e-3, "share of inf and NaN in an array, median"),
    *_features("at_limit", "1", 0.01, "share of an array equal to its maximum or minimum, median"),
    *_features("distinct", "1", 0.1, "share of distinct numbers in an array, median"),
    *_features("autocorrelation", "1", 5e-3, "lag-1 autocorrelation along an array, median"),
    *_features("roughness", "1", 1e-3, "second difference along an array over its values, median"),
)


class _Rhythm(NamedTuple):
    """Statistics of the times between the messages of a topic."""

    period_s: float  # median
    jitter: float  # median absolute deviation over the median
    gap: float  # maximum over the median


def _prepare_timing(window: fp.Window) -> dict[str, float]:
    """Return the steady topics and their periods [s]."""
    duration_s = window.end_s - window.start_s
    steady = {}
    for topic, arrivals in window.arrivals.items():
        rhythm = _rhythm(arrivals.times_s)
        if (
            rhythm is not None
            and len(arrivals.times_s) >= _FEWEST
            and rhythm.jitter <= _STEADY_JITTER
            and len(arrivals.times_s) * rhythm.period_s >= _STEADY_SHARE * duration_s
        ):
            steady[topic] = rhythm.period_s
    return steady


def _compute_timing(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute from the times and sizes of all messages."""
    topics = window.arrivals
    if not topics:
        return fp.Missing("no topic is recorded")
    steady: dict[str, float] = window.prepared
    counts = [len(arrivals.times_s) for arrivals in topics.values()]
    often = sum(count >= _FEWEST for count in counts)
    duration_s = window.end_s - window.start_s
    rhythms = {
        topic: rhythm for topic in steady if (rhythm := _rhythm(topics[topic].times_s)) is not None
    }
    gaps = {t: rhythm.gap * rhythm.period_s / steady[t] for t, rhythm in rhythms.items()}
    totals = {t: _totals(each.sizes, each.header_stamps_ns) for t, each in topics.items()}
    return {
        "message_rate": sum(counts) / duration_s,
        "byte_rate": sum(size for size, _ in totals.values()) / duration_s,
        "silent_topics": counts.count(0) / len(topics),
        "steady_topics": len(steady) / often if often else fp.Missing("all have few messages"),
        **_over_topics(
            "jitter", {t: rhythm.jitter for t, rhythm in rhythms.items()}, "no steady topic"
        ),
        "gap_max": largest(gaps, "no steady topic"),
        "out_of_order_max": largest(
            {topic: share for topic, (_, share) in totals.items()},
            "no topic with headers has two messages",
        ),
    }


def _compute_bytes(window: fp.Window) -> fp.Values:
    """Compute from the bytes of a few messages of each topic."""
    short = f"no message of {_SHORTEST} bytes or more"
    return _medians(window.topics["messages"], window, ("byte_entropy", "zlib_ratio"), short)


def _compute_arrays(window: fp.Window) -> fp.Values:
    """Compute from the arrays in messages."""
    none = "no array of floating-point numbers"
    return _medians(window.prepared, window, STATISTICS, none)


def _keep_bytes(record: fp.RawRecord) -> tuple[float, float] | None:
    """Return entropy [bit] and compressibility of the bytes' changes; None if there are few."""
    if len(record.data) < _SHORTEST:
        return None
    data = np.frombuffer(record.data, np.uint8, min(len(record.data), _LONGEST))
    changes = data[_STRIDE:] - data[:-_STRIDE]
    return _entropy(changes), len(zlib.compress(changes.tobytes(), 1)) / changes.size


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of any bag."""
    return [
        fp.FeaturePlugin(
            "generic_timing", "generic", _TIMING_FEATURES, _compute_timing,
            prepare=_prepare_timing,
        ),
        fp.FeaturePlugin(
            "generic_bytes", "generic", _BYTE_FEATURES, _compute_bytes,
            {"messages": fp.Request(_keep_bytes, raw=True, every_s=_SAMPLED_S, optional=True)},
        ),
        fp.FeaturePlugin(
            "generic_arrays", "generic", _ARRAY_FEATURES, _compute_arrays,
            {"arrays": ARRAYS},
            prepare=statistics_of_topics,
        ),
    ]  # fmt: skip


@jit
def _entropy(data: NDArray[np.uint8]) -> float:
    """Return the entropy of the values in some bytes [bit]."""
    counts = np.zeros(256)
    for value in data:
        counts[value] += 1.0
    entropy = 0.0
    for count in counts:
        if count:
            share = count / len(data)
            entropy -= share * math.log2(share)
    return entropy


def _rhythm(times_s: NDArray[np.float64]) -> _Rhythm | None:
    """Return the rhythm of at least three messages; None if the median time between them is 0."""
    if len(times_s) < 3:
        return None
    period_s, deviation_s, longest_s = _steps_between(times_s)
    if period_s <= 0.0:
        return None
    return _Rhythm(period_s, deviation_s / period_s, longest_s / period_s)


@jit
def _steps_between(times_s: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the median of the steps between times, their deviation from it, and the largest."""
    steps_s = times_s[1:] - times_s[:-1]
    period_s, deviation_s = median_and_deviation(steps_s)
    return period_s, deviation_s, steps_s.max()


@jit
def _totals(sizes: NDArray[np.int64], stamps_ns: NDArray[np.int64]) -> tuple[int, float]:
    """Return the sum of sizes, and the share of stamps that are earlier than their predecessor.

    The share is NaN without two stamps.
    """
    backwards = 0
    for i in range(1, len(stamps_ns)):
        backwards += stamps_ns[i] < stamps_ns[i - 1]
    return sizes.sum(), backwards / (len(stamps_ns) - 1) if len(stamps_ns) > 1 else math.nan


def _medians(
    topics: Mapping[str, fp.Series], window: fp.Window, names: tuple[str, ...], reason: str
) -> fp.Values:
    medians = {
        topic: column_medians(rows)
        for topic, (times_s, columns) in topics.items()
        if len(rows := columns[within(times_s, window)])
    }
    values: dict[str, float | fp.Located | fp.Missing] = {}
    for column, name in enumerate(names):
        by_topic = {topic: float(each[column]) for topic, each in medians.items()}
        values |= _over_topics(name, by_topic, reason)
    return values


def _over_topics(
    name: str, by_topic: Mapping[str, float], reason: str
) -> dict[str, float | fp.Located | fp.Missing]:
    values = {topic: value for topic, value in by_topic.items() if not np.isnan(value)}
    if not values:
        return dict.fromkeys((f"{name}_{each}" for each in _OVER_TOPICS), fp.Missing(reason))
    return {
        f"{name}_max": largest(values, reason),
        f"{name}_min": smallest(values, reason),
        f"{name}_mean": float(np.mean(list(values.values()))),
    }
