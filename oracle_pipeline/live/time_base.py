"""The time of a recording: simulated time if there is a ``/clock``, else wall time.

``ros2 bag record --use-sim-time`` makes the same choice: in simulated time, a window of 5 s is 5 s
of the robot, however fast the simulation runs. The stamp of a message is the simulated time at
which it was sent, interpolated between the clock ticks before and after, so the load of the
watching machine does not matter. After the newest tick, time continues at the rate of the last
ticks.

A clock that is set by more than a window, and a ``/clock`` that falls silent, are steps: what comes
after one belongs to another recording. How long something took is measured by the steady clock of
this machine, which is never set.
"""

import struct
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from oracle_pipeline.live.intake import QUEUE_BYTES, Received
from oracle_pipeline.windows import WINDOW_S

CLOCK_TOPIC = "/clock"

_TIME = struct.Struct("<iI")  # seconds, nanoseconds
_TICKS = 20  # that the rate is estimated from
_KEPT = 500  # ticks in memory
_OTHER_CLOCK_NS = 2_000_000_000  # without a tick, after which another publisher may take over
_SILENT_NS = 5_000_000_000  # without a tick, after which wall time counts
_LATEST_NS = 1_000_000_000  # longest transport time; beyond it, the machines' clocks disagree
_STEP_NS = round(WINDOW_S * 1e9)  # smallest step
_FASTEST = 100.0  # real-time factor of a simulation whose rate is not known yet
_SECOND_NS = 1_000_000_000


class Stamped(NamedTuple):
    """A message and its stamp in the time of the recording."""

    message: Received
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Step:
    """Time was set, or has changed to another one."""

    reason: str


class RobotTime:
    """Stamps messages, and notices steps.

    Parameters
    ----------
    simulated : bool
        Whether there is a ``/clock``.
    """

    def __init__(self, *, simulated: bool) -> None:
        self._wall = _WallTime()
        self._simulated = _SimulatedTime() if simulated else None
        self._current: _WallTime | _SimulatedTime = self._simulated or self._wall
        self._waiting: list[Received] = []  # until the time is known
        self._waiting_bytes = 0

    @property
    def name(self) -> str:
        """Either ``simulated`` or ``wall``."""
        return "wall" if self._current is self._wall else "simulated"

    def stamped(self, came: Iterable[Received]) -> Iterator[Stamped | Step]:
        """Yield messages with their stamps, once the time is known, and steps between them."""
        for message in came:
            if step := self._step(message):
                yield from self._known()
                self._switch(message)
                yield step
            self._wall.follow(message)
            if self._simulated is not None and message.topic == CLOCK_TOPIC:
                self._simulated.tick(message)
            self._waiting.append(message)
            self._waiting_bytes += len(message.data)
        yield from self._known()

    def now_ns(self, steady_ns: int) -> int | None:
        """Return the time at a steady time of this machine; None if it is not known."""
        return self._current.now_ns(steady_ns) if self._current.is_ready else None

    def _known(self) -> Iterator[Stamped]:
        if self._current.is_ready:
            waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
            for message in waiting:
                yield Stamped(message, self._current.stamp_ns(message))

    def _step(self, message: Received) -> Step | None:
        simulated = self._simulated
        if simulated is None:
            return _step_of("The clock of this machine", self._wall.jump_ns(message))
        if self._current is simulated:
            if simulated.is_silent(message) or self._waiting_bytes > QUEUE_BYTES:
                return Step("/clock does not tick; from here on, wall time counts.")
            is_tick = message.topic == CLOCK_TOPIC
            return _step_of("/clock", simulated.jump_ns(message)) if is_tick else None
        if simulated.is_ready and not simulated.is_silent(message):
            return Step("/clock ticks again; from here on, simulated time counts.")
        return _step_of("The clock of this machine", self._wall.jump_ns(message))

    def _switch(self, message: Received) -> None:
        """Choose the clock that counts from a message on."""
        simulated = self._simulated
        if simulated is None:
            self._wall = self._current = _WallTime()
        elif simulated.is_silent(message) or self._waiting_bytes > QUEUE_BYTES:
            self._simulated = _SimulatedTime()
            self._current = self._wall = _WallTime()
        elif self._current is simulated:
            self._current = self._simulated = _SimulatedTime()
        else:
            self._current = simulated


def _step_of(clock: str, jump_ns: int) -> Step | None:
    if not jump_ns:
        return None
    direction = "forward" if jump_ns > 0 else "back"
    return Step(f"{clock} was set {direction} by {abs(jump_ns) / _SECOND_NS:.1f} s.")


class _WallTime:
    """Wall time: stamps are times of arrival; they never run back."""

    is_ready = True

    def __init__(self) -> None:
        self._offset_ns: int | None = None  # of wall time to steady time
        self._last_ns = 0

    def jump_ns(self, message: Received) -> int:
        """Return by how much the clock was set since the last message; 0 for less than a step."""
        if self._offset_ns is None:
            return 0
        jump_ns = message.wall_ns - message.steady_ns - self._offset_ns
        return jump_ns if abs(jump_ns) > _STEP_NS else 0

    def follow(self, message: Received) -> None:
        """Take the clock's time from a message."""
        self._offset_ns = message.wall_ns - message.steady_ns

    def stamp_ns(self, message: Received) -> int:
        """Return the stamp of a message."""
        self._last_ns = max(self._last_ns, message.wall_ns)
        return self._last_ns

    def now_ns(self, steady_ns: int) -> int:
        """Return the present time."""
        return max(self._last_ns, steady_ns + (self._offset_ns or 0))


class _SimulatedTime:
    """Simulated time, from the ticks of ``/clock``; one publisher of it counts at a time."""

    def __init__(self) -> None:
        self._steady: list[int] = []  # when the ticks were sent, ascending [ns]
        self._times: list[int] = []  # simulated times of the ticks [ns]
        self._clock: int | None = None  # handle of the publisher
        self._ticked_ns: int | None = None
        self._offset_ns = 0  # keeps time from running back when a simulation starts anew
        self._last_ns = 0

    @property
    def is_ready(self) -> bool:
        """Whether there were enough ticks to know the time and its rate."""
        return len(self._steady) > 1

    def is_silent(self, message: Received) -> bool:
        """Return whether there was no tick for long when a message came."""
        if self._ticked_ns is None:
            self._ticked_ns = message.steady_ns
        return message.steady_ns - self._ticked_ns > _SILENT_NS

    def jump_ns(self, message: Received) -> int:
        """Return by how much a tick differs from what is expected; 0 for less than a step."""
        sent_ns = _sent_ns(message)
        if not self._times or self._is_of_other(message, sent_ns):
            return 0
        passed_ns = _time_ns(message) - self._times[-1]
        expected_ns = (self._speed() or _FASTEST) * max(0, sent_ns - self._steady[-1])
        is_step = passed_ns < -_STEP_NS or passed_ns > _STEP_NS + 2.0 * expected_ns
        return round(passed_ns - self._speed() * (sent_ns - self._steady[-1])) if is_step else 0

    def tick(self, message: Received) -> None:
        """Take a tick of the clock, a ``rosgraph_msgs/msg/Clock`` as CDR."""
        sent_ns = _sent_ns(message)
        if self._is_of_other(message, sent_ns):
            return
        self._clock, self._ticked_ns = message.writer, message.steady_ns
        now_ns = _time_ns(message)
        if self._times and now_ns < self._times[-1]:
            self._offset_ns = self._last_ns - now_ns
            self._steady.clear()
            self._times.clear()
        if not self._times or (now_ns > self._times[-1] and sent_ns > self._steady[-1]):
            self._steady.append(sent_ns)
            self._times.append(now_ns)
            del self._steady[:-_KEPT], self._times[:-_KEPT]

    def stamp_ns(self, message: Received) -> int:
        """Return the stamp of a message; it never runs back."""
        return self.now_ns(_sent_ns(message))

    def now_ns(self, steady_ns: int) -> int:
        """Return the simulated time at a steady time; it never runs back."""
        steady, times = self._steady, self._times
        after = bisect_right(steady, steady_ns)
        if after == 0:
            now_ns = times[0]
        elif after < len(steady):
            (before, next_) = steady[after - 1 : after + 1]
            (time, next_time) = times[after - 1 : after + 1]
            now_ns = time + (next_time - time) * (steady_ns - before) // (next_ - before)
        else:
            now_ns = times[-1] + self._since_last(steady_ns)
        self._last_ns = max(self._last_ns, self._offset_ns + now_ns)
        return self._last_ns

    def _is_of_other(self, message: Received, sent_ns: int) -> bool:
        """Return whether a tick is of a second clock, while the first one ticks."""
        return (
            self._clock not in (None, message.writer)
            and self._ticked_ns is not None
            and sent_ns - self._ticked_ns < _OTHER_CLOCK_NS
        )

    def _speed(self) -> float:
        """Return simulated time by steady time, of the last ticks; 0 if there is one tick."""
        steady, times = self._steady[-_TICKS:], self._times[-_TICKS:]
        return (times[-1] - times[0]) / max(1, steady[-1] - steady[0])

    def _since_last(self, steady_ns: int) -> int:
        """Return how much simulated time has passed since the newest tick, at most a tick [ns]."""
        times = self._times[-_TICKS:]
        tick = (times[-1] - times[0]) / max(1, len(times) - 1)
        return round(min((steady_ns - self._steady[-1]) * self._speed(), tick))


def _time_ns(tick: Received) -> int:
    seconds, nanoseconds = _TIME.unpack_from(tick.data, 4)
    return int(seconds) * _SECOND_NS + int(nanoseconds)


def _sent_ns(message: Received) -> int:
    """Return when a message was sent, in steady time; if that is implausible, when it arrived."""
    transport_ns = message.wall_ns - message.sent_ns
    return message.steady_ns - (transport_ns if 0 <= transport_ns <= _LATEST_NS else 0)
