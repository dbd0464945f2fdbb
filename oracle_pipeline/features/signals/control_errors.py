"""Control errors: what follows a command, minus the command, as signals of their own.

A stuck joint, an offset of an encoder or a late answer changes little in the numbers themselves,
which differ with the task, and much in how they follow their commands. The lag is a signal, too. A
command is known by its name, such as ``/cmd_vel``, ``/action`` or ``desired.positions[0]``. What
follows it has the same name apart from such words, or a longer or shorter one with the same end.
"""

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.datasets import LAG, MINUS
from oracle_pipeline.features.signals.collector import PERIOD, Floats, Signals

FEWEST = 10  # numbers with a lag
STEADY = 1e-6  # share of the squared rates of a command: one that changes less tells no lag
MOST_FOLLOWERS = 4  # of a command; more share only a common name, such as `data`
_OF_COMMANDS = {
    "action", "cmd", "command", "commanded", "ctrl", "d", "demand", "demanded", "des", "desired",
    "leader", "master", "ref", "reference", "setpoint", "sp", "tar", "target", "tgt",
}  # fmt: skip
_OF_FOLLOWERS = {
    "act", "actual", "current", "est", "estimate", "estimated", "fb", "feedback", "follower",
    "meas", "measured", "measurement", "obs", "observation", "odom", "present", "puppet", "real",
    "sensed", "state",
}  # fmt: skip
_NEITHER = {"err", "error", "length"}  # errors that are published, and sizes
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")

Words: TypeAlias = tuple[str, ...]
Prepared: TypeAlias = tuple[Signals, Floats]


class _Number(NamedTuple):
    """One of the signals, by the words of its names that tell neither command nor follower."""

    signals: Signals
    column: int
    period: float  # of an angle, otherwise 0
    is_command: bool
    topic: Words
    path: Words  # those of the topic, if the field is just a command

    @property
    def unit(self) -> str:
        """Return the unit, empty if it is unknown."""
        return self.signals.units[self.column]


def control_errors(prepared: Sequence[Prepared]) -> list[Prepared]:
    """Return what follows commands minus the command that was the last one at each time.

    Parameters
    ----------
    prepared : sequence of (Signals, ndarray)
        The signals of one recording, and the period of each that is an angle, otherwise 0.

    Examples
    --------
    >>> times_ns = np.arange(3)
    >>> action = Signals("/action", ("elbow",), ("",), times_ns, np.array([[0.0], [1.0], [2.0]]))
    >>> state = Signals("/state", ("elbow",), ("",), times_ns, np.array([[0.0], [0.5], [1.5]]))
    >>> ((error, _),) = control_errors([(action, np.zeros(1)), (state, np.zeros(1))])
    >>> error.topic, error.names, error.values.ravel().tolist()
    ('/state', ('elbow minus action.elbow',), [0.0, -0.5, -0.5])
    """
    numbers = [number for each in prepared for number in _numbers(*each)]
    followers: dict[Words, list[_Number]] = defaultdict(list)
    for number in numbers:
        for end in _ends(number.path) if not number.is_command else ():
            followers[end].append(number)
    pairs = [(c, f) for c in numbers if c.is_command for f in _following(c, followers)]
    some = [(c, f) for c, f in pairs if c.signals.times_ns[0] <= f.signals.times_ns[-1]]
    return [error for c, f in some for error in _errors(c, f)]


def _numbers(signals: Signals, periods: Floats) -> Iterator[_Number]:
    if signals.names == (PERIOD,) or not len(signals.times_ns):
        return
    of_topic, topic = _words(signals.topic.replace("/_action/", "/"))
    for column, name in enumerate(signals.names):
        of_field, path = _words(name)
        is_command, period = of_topic or of_field, float(periods[column])
        if _NEITHER.isdisjoint(path):
            yield _Number(signals, column, period, is_command, topic, path or topic)


def _words(name: str) -> tuple[bool, Words]:
    """Return whether a name is that of a command, and its other words."""
    words = words_in(name)
    others = tuple(w for w in words if not is_of(_OF_COMMANDS | _OF_FOLLOWERS, w))
    return any(is_of(_OF_COMMANDS, word) for word in words), others


def words_in(name: str) -> list[str]:
    """Return the words and numbers in a name, in lower case."""
    return [word.lower() for word in _WORD.findall(name)]


def is_of(some: set[str], word: str) -> bool:
    """Return whether a word, or what it is the plural of, is one of some."""
    return word in some or word.removesuffix("s") in some


def _ends(path: Words) -> list[Words]:
    """Return a path, and its ends of at least two words."""
    return [path, *(path[start:] for start in range(1, len(path) - 1))]


def _following(command: _Number, followers: Mapping[Words, list[_Number]]) -> list[_Number]:
    """Return what follows a command: of topics with a like name, if there are any."""
    alike = [
        *followers.get(command.path, ()),
        *(f for end in _ends(command.path)[1:] for f in followers.get(end, ()) if f.path == end),
    ]
    found = [each for each in alike if len({command.unit, each.unit} - {""}) < 2]
    near = [each for each in found if each.topic == command.topic] or found
    return near if len(near) <= MOST_FOLLOWERS else []


def _errors(command: _Number, follower: _Number) -> Iterator[Prepared]:
    """Yield the errors, and one lag [s] of the recording, unless the command is steady."""
    told, own = command.signals, follower.signals
    last = np.searchsorted(told.times_ns, own.times_ns, side="right") - 1
    known = last >= 0
    times_ns, commands = own.times_ns[known], told.values[:, command.column]
    errors = own.values[known, follower.column] - commands[last[known]]
    named = f"{told.topic.strip('/').replace('/', '.')}.{told.names[command.column]}"
    name = f"{own.names[follower.column]}{MINUS}{named}"
    adjacent = None if own.adjacent is None else own.adjacent[known]
    units = (follower.unit,)
    signals = Signals(own.topic, (name,), units, times_ns, errors[:, None], adjacent)
    yield signals, np.array([follower.period])
    lag_s = _lag_s(errors, np.interp(times_ns, told.times_ns, commands), times_ns)
    if np.isfinite(lag_s):
        lag = np.array([[lag_s]])
        yield Signals(own.topic, (f"{name}{LAG}",), ("s",), times_ns[-1:], lag), np.zeros(1)


def _lag_s(errors: Floats, commands: Floats, times_ns: NDArray[np.int64]) -> float:
    """Return the lag behind smooth commands, by least squares; NaN if they are steady.

    Commands that change by rounding errors only would give a lag of years.
    """
    different = np.flatnonzero(np.diff(times_ns, prepend=-1))
    if len(different) < FEWEST:
        return math.nan
    rates = np.gradient(commands[different], times_ns[different] * 1e-9)
    changes = rates - rates.mean()
    power = float(changes @ changes)
    told = power > STEADY * float(rates @ rates)
    lag_s = -float(errors[different] @ changes) / power if told else math.nan
    return lag_s if abs(lag_s) < np.ptp(times_ns) * 1e-9 else math.nan
