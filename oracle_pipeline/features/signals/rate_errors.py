"""Rate errors: a rate in a message, minus the rate at which the number beside it changes.

Joints tell a position and a velocity, vehicles a place and a speed. A sensor that is off, noisy or
badly scaled, and a message of which one field was altered, change each of them little beside what
differs with the task, and much in how they agree. A rate is known by its name: ``velocity[0]``
beside ``position[0]``, ``vx`` beside ``x``, or ``angular_velocity.z`` beside ``orientation.yaw``.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator

import numpy as np

from oracle_pipeline.datasets import MINUS
from oracle_pipeline.features.signals.collector import Signals
from oracle_pipeline.features.signals.control_errors import Words, is_of, words_in

# Of a difference, at least: messages come with a jitter of milliseconds. Below 50 ms, so that no
# rounding error decides how many messages of 5, 10 or 25 ms it spans.
SPAN_S = 0.049
_ORDERS = (
    {"angle", "attitude", "orientation", "pos", "pose", "position", "q"},
    {"angular", "qd", "rate", "speed", "twist", "vel", "velocities", "velocity"},
    {"acc", "accel", "acceleration", "qdd"},
)  # words of a level, of its rate, and of the rate of that
_ABOUT = {"x": "roll", "y": "pitch", "z": "yaw"}  # axes of angular rates
_FUSED = re.compile(r"(?<![a-z])([av]|roll|pitch|yaw)([xyz]|rate|speed)(?![a-z])", re.IGNORECASE)
_LETTERS = {"a": "acceleration", "v": "velocity"}  # in such names as ax and vx


def rate_errors(signals: Iterable[Signals]) -> list[Signals]:
    """Return rates minus the rates of change of what has the same name in the same messages.

    Angles are without jumps of a turn.

    Examples
    --------
    >>> times_ns = np.arange(11) * 10**8
    >>> values = np.column_stack([0.2 * np.arange(11), np.ones(11)])
    >>> joints = Signals("/joints", ("position[0]", "velocity[0]"), ("", ""), times_ns, values)
    >>> (error,) = rate_errors([joints])
    >>> error.names, error.values[:3].ravel().round(9).tolist()
    (('velocity[0] minus rate of position[0]',), [-1.0, -1.0, -1.0])
    """
    # Where not all messages were read, what lies between them is unknown.
    whole = [each for each in signals if each.adjacent is None]
    return [error for each in whole for error in _of_topic(each)]


def _of_topic(signals: Signals) -> Iterator[Signals]:
    named: dict[tuple[int, Words], list[int]] = defaultdict(list)
    for column, name in enumerate(signals.names):
        named[_order_and_path(name)].append(column)
    for (order, path), rates in named.items():
        levels = named.get((order - 1, path), [])
        if len(rates) == len(levels) == 1:
            (rate,), (level,) = rates, levels
            if signals.names[rate] != f"{signals.names[level]}.rate":  # computed, of a counter
                yield _error(signals, rate, level)


def _order_and_path(name: str) -> tuple[int, Words]:
    """Return which rate a name tells, 0 for a level, and its other words.

    Examples
    --------
    >>> _order_and_path("actual.velocities[3]"), _order_and_path("vx")
    ((1, ('actual', '3')), (1, ('x',)))
    >>> _order_and_path("angular_velocity.z"), _order_and_path("orientation.yaw")
    ((1, ('yaw',)), (0, ('yaw',)))
    """
    words = words_in(_FUSED.sub(lambda m: f"{_LETTERS.get(m[1].lower(), m[1])}.{m[2]}", name))
    orders = [[n for n, some in enumerate(_ORDERS) if is_of(some, word)] for word in words]
    path = [word for word, of in zip(words, orders, strict=True) if not of]
    if "angular" in words:
        path = [_ABOUT.get(word, word) for word in path]
    return max((n for of in orders for n in of), default=0), tuple(path)


def _error(signals: Signals, rate: int, level: int) -> Signals:
    """Return the error since the last message that is at least `SPAN_S` old."""
    known = np.isfinite(signals.values[:, [rate, level]]).all(axis=1)
    times_ns, values = signals.times_ns[known], signals.values[known]
    # A loaded machine receives messages late, so their stamps count.
    times_s = times_ns * 1e-9 if signals.stamps_s is None else signals.stamps_s[known]
    rates, levels = values[:, rate], values[:, level]
    moved = np.cumsum((rates[1:] + rates[:-1]) / 2.0 * np.diff(times_s))
    drift = np.append(0.0, moved)[: len(levels)] - levels
    earlier = np.searchsorted(times_s, times_s - SPAN_S, side="right") - 1
    spans_s = times_s - times_s[earlier]
    told = (earlier >= 0) & (spans_s > 0.0)
    errors = (drift - drift[earlier])[told] / spans_s[told]
    name = f"{signals.names[rate]}{MINUS}rate of {signals.names[level]}"
    units = (signals.units[rate],)
    return Signals(signals.topic, (name,), units, times_ns[told], errors[:, np.newaxis])
