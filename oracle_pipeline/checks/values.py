"""Checks of the numbers in messages: stuck, jumping, out of range, not finite, not a rotation."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.terminal import count_of, join_first
from oracle_pipeline.checks.topic import (
    FEWEST,
    CheckedSignal,
    CheckedTopic,
    Fault,
    Floats,
    runs,
    signals_of,
    step_spans,
    worst,
)
from oracle_pipeline.features.signals.units import of_fields, period_of
from oracle_pipeline.logs.recording import MADE_TYPES
from oracle_pipeline.scoring.fingerprints import repeated_numbers

_STUCK_MESSAGES, _STUCK_S = 10, 1.0  # a stuck stretch has both
_LONGER = 10.0  # so many times longer than any other stretch of equal numbers
_REPLAYED = 20  # values in the order of before; of 2,569 numbers of real robots, none has 5
_VELOCITIES = ("m/s", "rad/s")
_MOTION = ("nav_msgs/", "geometry_msgs/", "tf2_msgs/", "ackermann_msgs/", "sensor_msgs/msg/Joint")
_PLACES = ("x", "y", "z", "latitude", "longitude")
_JUMP, _USUAL = 30.0, 0.99  # a jump, in steps of this quantile
_FASTEST = 5.0  # slower than this no jump of a position is reported [m/s]
_METRES_PER_DEGREE = 111_320.0
_EQUAL_SHARE, _EQUAL_RUN, _DISTINCT = 0.05, 10, 50  # of a saturated signal
_MEASURED = ("m/s^2", "rad/s", "N", "N m", "T", "A", "V")
_NORM = 0.01  # tolerance of a quaternion's norm
_SHARE, _STRETCHES = 0.05, 10  # without a value: beyond both, that is usual, and no fault
_WRAPS = (2.0**8, 2.0**16, 2.0**32)  # after so many numbers, a counter begins again
_COUNTS = 0.95  # of a counter's steps are equal

LIMITS: Mapping[tuple[str, str], tuple[float, float]] = of_fields(
    Path(__file__).with_name("limits.yaml")
)


def stuck(topic: CheckedTopic) -> Iterator[Fault]:
    """Find stretches in which numbers that always change are all the same.

    A topic is stuck if all its lively signals are. A robot that stands still is not: what it
    commands, or believes about its motion, may be constant.
    """
    lively = [signal for signal in signals_of(topic) if signal.is_lively]
    if not lively or len({len(signal.values) for signal in lively}) > 1:
        return
    same = np.all([np.diff(signal.values) == 0.0 for signal in lively], axis=0)
    times_s = lively[0].times_s
    found = _long(runs(same), times_s)
    if topic.is_command:
        found = found[found[:, 0] > 0]  # before a start, nothing is commanded
    if topic.msgtype.startswith(_MOTION):
        found = found[[_moves(lively, first) for first in found[:, 0].tolist()]]
    if len(found):
        spans = np.column_stack([times_s[found[:, 0]], times_s[found[:, 1]]])
        names = join_first([signal.name for signal in lively])
        yield worst(
            "stuck", topic.name, "", spans, spans[:, 1] - spans[:, 0], "s",
            f"{names} do not change for {{size}} s from {{at}} on",
        )  # fmt: skip


def _long(found: NDArray[np.int64], times_s: Floats) -> NDArray[np.int64]:
    """Return the stretches that are long, and much longer than all that are not."""
    lengths = found[:, 1] - found[:, 0]
    lasted_s = times_s[found[:, 1]] - times_s[found[:, 0]]
    is_long = (lengths >= _STUCK_MESSAGES) & (lasted_s >= _STUCK_S)
    usual = int(lengths[~is_long].max(initial=1))
    return found[is_long & (lengths >= _LONGER * usual)]


def _moves(lively: list[CheckedSignal], row: int) -> bool:
    """Return whether the robot has a velocity at a message."""
    return any(s.unit in _VELOCITIES and abs(s.values[row]) > 1e-3 for s in lively)


def replays(topic: CheckedTopic) -> Iterator[Fault]:
    """Find measurements that come again in the order of before: a recording of them is replayed.

    Numbers that are rounded to few values, or that change evenly, are not compared.
    """
    numbers = () if topic.is_command else repeated_numbers(topic.signals)
    again = {name: of.times_ns[rows] for of, name, rows in numbers if len(rows) >= _REPLAYED}
    if again:
        spans = np.array([times_ns[[0, -1]] for times_ns in again.values()]) / 1e9
        yield worst(
            "replay", topic.name, "", spans, spans[:, 1] - spans[:, 0], "s",
            f"{join_first(list(again))} come again as before for {{size}} s from {{at}} on",
        )  # fmt: skip


def jumps(topic: CheckedTopic) -> Iterator[Fault]:
    """Find places that jump: steps far larger than nearly all others, after which they stay.

    Only places are inspected, since velocities and forces may change at once.
    """
    for signal in signals_of(topic):
        if not _is_place(signal) or len(signal.values) < 4 * FEWEST:
            continue
        values = _unwrapped(signal)
        steps = np.diff(values)
        moved = np.abs(steps[steps != 0.0])  # none, if angles only turn full circles
        usual = float(np.quantile(moved, _USUAL)) if len(moved) else np.inf
        found = np.flatnonzero(np.abs(steps) > _JUMP * usual)
        found = found[[_stays(values, at) for at in found.tolist()]]
        scale = _METRES_PER_DEGREE if signal.unit == "deg" else 1.0
        took_s = np.maximum(np.diff(signal.times_s)[found], 1e-3)
        found = found[np.abs(steps[found]) * scale / took_s > _FASTEST]
        if len(found):
            spans = step_spans(signal.times_s, found)
            usual_text = f"nearly all steps are below {usual:.3g}"
            yield worst(
                "jump", topic.name, signal.name, spans, steps[found], signal.unit,
                f"{signal.name} jumps by {{size}}{_of(signal.unit)} at {{at}}; {usual_text}",
            )  # fmt: skip


def _is_place(signal: CheckedSignal) -> bool:
    """Return whether a signal is where something is."""
    last = signal.name.rpartition(".")[2].rpartition("_")[2]
    return last in _PLACES and signal.unit in ("m", "deg", "") and signal.is_lively


def _unwrapped(signal: CheckedSignal) -> Floats:
    values, good = signal.values.copy(), np.isfinite(signal.values)
    values[~good] = np.interp(signal.times_s[~good], signal.times_s[good], values[good])
    period = period_of(signal.name, signal.unit, float(np.abs(values).max()))
    return np.unwrap(values, period=period) if period else values


def _stays(values: Floats, at: int) -> bool:
    """Return whether numbers after a step are far from those before it."""
    before, after = values[max(0, at - 4) : at + 1], values[at + 1 : at + 6]
    step = abs(values[at + 1] - values[at])
    return len(after) > 1 and bool(abs(np.median(after) - np.median(before)) > 0.5 * step)


def saturation(topic: CheckedTopic) -> Iterator[Fault]:
    """Find measurements that rest at their largest or smallest number."""
    if topic.msgtype.startswith(("geometry_msgs/msg/Twist", "nav_msgs/")):
        return  # commands and their results have limits
    for signal in signals_of(topic):
        if signal.unit not in _MEASURED or not signal.is_lively:
            continue
        if len(np.unique(signal.values)) < _DISTINCT:
            continue
        for limit in (float(np.nanmax(signal.values)), float(np.nanmin(signal.values))):
            at_limit = signal.values == limit
            found = runs(at_limit)
            longest = int((found[:, 1] - found[:, 0]).max(initial=0))
            if at_limit.mean() >= _EQUAL_SHARE and longest >= _EQUAL_RUN:
                ends = np.minimum(found[:, 1], len(signal.values) - 1)
                spans = np.column_stack([signal.times_s[found[:, 0]], signal.times_s[ends]])
                yield worst(
                    "saturation", topic.name, signal.name, spans, spans[:, 1] - spans[:, 0], "s",
                    f"{signal.name} rests at its limit of {limit:.4g}{_of(signal.unit)} for "
                    "{size} s from {at} on",
                )  # fmt: skip


def limits(topic: CheckedTopic) -> Iterator[Fault]:
    """Find numbers beyond what their type or physics allow."""
    for signal in signals_of(topic):
        low, high = _limits(topic.msgtype, signal.name)
        beyond = np.maximum(low - signal.values, signal.values - high)
        found = np.flatnonzero(np.isfinite(signal.values) & (beyond > 0.0))
        if len(found):
            yield worst(
                "limit", topic.name, signal.name, _at(signal, found), signal.values[found],
                signal.unit,
                f"{signal.name} is {{size}}{_of(signal.unit)} at {{at}}; it must be between "
                f"{low:g} and {high:g}",
            )  # fmt: skip


def _limits(msgtype: str, name: str) -> tuple[float, float]:
    for (of, field), both in LIMITS.items():
        if of == msgtype and f"{name}.".startswith(f"{field}."):
            return both
    return -math.inf, math.inf


def not_finite(topic: CheckedTopic) -> Iterator[Fault]:
    """Find NaN and infinity in signals that are finite as a rule."""
    if topic.is_command or topic.msgtype == "sensor_msgs/msg/Range":
        return  # NaN is "as it is" there, and infinity "no return", REP 117
    places: dict[str, Floats] = {}
    for signal in signals_of(topic):
        bad = ~np.isfinite(signal.values)
        if len(bad) < FEWEST:
            continue
        bad[: int(np.argmin(bad))] = False  # before the first number there was none yet
        after = int(np.argmin(bad[::-1]))  # messages after the last number
        if after == 1 or topic.msgtype.startswith(MADE_TYPES):  # a table ends with blank cells
            bad[len(bad) - after :] = False
        is_usual = bad.mean() > _SHARE and len(runs(bad)) > _STRETCHES
        if bad.any() and bad.mean() < 0.5 and not is_usual:
            places[signal.name] = _at(signal, np.flatnonzero(bad))
    if places:
        spans, names = np.unique(np.concatenate([*places.values()]), axis=0), join_first([*places])
        yield worst(
            "not_finite", topic.name, names if len(places) == 1 else "", spans,
            np.ones(len(spans)), "1", f"NaN or infinity {{count}} times, first at {{at}}: {names}",
        )  # fmt: skip


def rotations(topic: CheckedTopic) -> Iterator[Fault]:
    """Find quaternions whose norm is not 1. Where all are 0, there is no orientation."""
    for signal in signals_of(topic):
        if not signal.name.endswith(".norm") or not np.any(signal.values > 0.0):
            continue
        off = np.abs(signal.values - 1.0)
        found = np.flatnonzero(off > _NORM)
        if len(found):
            yield worst(
                "quaternion", topic.name, signal.name, _at(signal, found), off[found], "1",
                f"the norm of {signal.name.removesuffix('.norm')} is off 1 by {{size}} at {{at}}, "
                "{count} times in all",
            )  # fmt: skip


def counters(topic: CheckedTopic) -> Iterator[Fault]:
    """Find counters that go back, or skip numbers: messages were lost."""
    for signal in signals_of(topic):
        steps = np.diff(signal.values)
        if len(steps) < FEWEST or not np.all(np.mod(signal.values, 1.0) == 0.0):
            continue
        step = float(np.median(steps))
        if step <= 0.0 or np.mean(steps == step) < _COUNTS:
            continue
        lost = steps / step - 1.0  # whole numbers of a counter; of a time they need not be
        back = np.flatnonzero((steps < 0.0) & ~np.isin(step - steps, _WRAPS))
        skipped = np.flatnonzero((lost > 0.0) & (np.mod(lost, 1.0) == 0.0))
        if len(back):
            yield worst(
                "counter", topic.name, signal.name, step_spans(signal.times_s, back), steps[back],
                "1", f"{signal.name} goes back by {{size}} at {{at}}, {{count}} times in all",
            )  # fmt: skip
        if len(skipped):
            yield worst(
                "lost", topic.name, signal.name, step_spans(signal.times_s, skipped), lost[skipped],
                "1", f"{signal.name} skips {{size}} numbers at {{at}}; "
                f"{count_of(int(lost[skipped].sum()), 'message')} lost in all",
            )  # fmt: skip


def _at(signal: CheckedSignal, rows: NDArray[np.int64]) -> Floats:
    return np.column_stack([signal.times_s[rows], signal.times_s[rows]])


def _of(unit: str) -> str:
    return f" {unit}" if unit not in ("", "1") else ""
