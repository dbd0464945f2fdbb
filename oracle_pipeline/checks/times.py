"""Checks of when messages came: gaps, late bursts, stamps and clocks that go back."""

from collections.abc import Iterable, Iterator

import numpy as np

from oracle_pipeline.checks.topic import FEWEST, CheckedTopic, Fault, Floats, step_spans, worst

_STEADY = 3.0  # the 95th percentile of a steady topic's periods, in medians
_SPEAKS = 0.25  # of the time, at least
_GAP, _SHORTEST_GAP_S = 10.0, 0.5  # a gap is both: in periods, and in seconds
_LATE, _SHORTEST_LATE_S = 5.0, 0.2  # so is a delay before a burst
_AT_ONCE, _BURST = 0.2, 3  # messages of a burst follow each other in this share of a period
_DISORDER = 0.01  # more stamps that go back come from several publishers
_STEP_NS = 1_000_000  # smaller steps back are rounding


def gaps(topic: CheckedTopic) -> Iterator[Fault]:
    """Find times in which a topic with a steady rate was silent; commands are sent on demand."""
    steps, period = _steps(topic)
    if not period or topic.is_command:
        return
    found = np.flatnonzero(steps > max(_GAP * period, _SHORTEST_GAP_S))
    if len(found):
        yield worst(
            "gap", topic.name, "", step_spans(topic.times_s, found), steps[found], "s",
            f"no message for {{size}} s at {{at}}, where there is one each {period:.3g} s",
        )  # fmt: skip


def late_bursts(topic: CheckedTopic) -> Iterator[Fault]:
    """Find messages that were held back and then came at once."""
    steps, period = _steps(topic)
    if not period:
        return
    late = np.flatnonzero(steps > max(_LATE * period, _SHORTEST_LATE_S))
    quick = steps < _AT_ONCE * period
    found = late[[bool(quick[at + 1 : at + 1 + _BURST].sum() == _BURST) for at in late.tolist()]]
    if len(found):
        yield worst(
            "late_burst", topic.name, "", step_spans(topic.times_s, found), steps[found], "s",
            "messages were held back for {size} s at {at}, and then came at once",
        )  # fmt: skip


def stamps(topic: CheckedTopic) -> Iterator[Fault]:
    """Find stamps in headers that are older than those before."""
    back = -np.diff(topic.stamps_ns)
    found = np.flatnonzero(back > _STEP_NS)
    if len(found) and len(found) <= _DISORDER * len(topic.stamps_ns):
        yield worst(
            "stamp", topic.name, "header.stamp", step_spans(topic.times_s, found),
            back[found] * 1e-9, "s",
            "the stamp goes back by {size} s at {at}, {count} times in all",
        )  # fmt: skip


def steps_back(set_back: Iterable[tuple[float, float]]) -> Iterator[Fault]:
    """Yield when the recorder's clock was set back: `Timeline.set_back`."""
    for at_s, by_s in set_back:
        text = f"the recorder's clock was set back by {by_s:.4g} s at {at_s:.2f} s"
        yield Fault("clock", "", "", at_s, at_s, by_s, "s", 1, text)


def _steps(topic: CheckedTopic) -> tuple[Floats, float]:
    """Return times between messages, and the period of a steady topic; 0 of another one.

    Bursts of messages, such as those of a home position, are not steady.
    """
    steps = np.diff(topic.times_s)
    if len(steps) < FEWEST:
        return steps, 0.0
    median, high = np.quantile(steps, (0.5, 0.95))
    speaks = len(steps) * median >= _SPEAKS * steps.sum()
    return steps, float(median) if speaks and 0.0 < high <= _STEADY * median else 0.0
