"""The time of a recording: simulated time if there is a ``/clock``, else wall time.

``ros2 bag record --use-sim-time`` makes the same choice: in simulated time, a window of 5 s is 5 s
of the robot, however fast the simulation runs. The stamp of a message is the simulated time at
which it was sent, interpolated between the clock ticks before and after, so the load of the
watching machine does not matter. After the newest tick, time continues at the rate of the last
ticks.
"""

import struct
from bisect import bisect_right

from oracle_pipeline.live.intake import Received

CLOCK_TOPIC = "/clock"

_TIME = struct.Struct("<iI")  # seconds, nanoseconds
_TICKS = 20  # that the rate is estimated from
_KEPT = 500  # ticks in memory
_SILENT_NS = 2_000_000_000  # of wall time, after which another clock may take over
_LATEST_NS = 1_000_000_000  # longest transport time; beyond it, the machines' clocks disagree
_SECOND_NS = 1_000_000_000


class WallTime:
    """Wall time: stamps are times of arrival."""

    is_ready = True

    def tick(self, message: Received) -> None:
        """Ignore a tick of ``/clock``."""

    def stamp_ns(self, message: Received) -> int:
        """Return the stamp of a message."""
        return message.wall_ns

    def now_ns(self, wall_ns: int) -> int:
        """Return the present time."""
        return wall_ns


class SimulatedTime:
    """Simulated time, from the ticks of ``/clock``; one publisher of it counts at a time."""

    def __init__(self) -> None:
        self._walls: list[int] = []  # wall times of the ticks, ascending [ns]
        self._times: list[int] = []  # simulated times of the ticks [ns]
        self._clock: int | None = None  # handle of the publisher
        self._ticked_ns = 0
        self._offset_ns = 0  # keeps time from running back when a simulation starts anew
        self._last_ns = 0

    @property
    def is_ready(self) -> bool:
        """Whether there were enough ticks to know the time and its rate."""
        return len(self._walls) > 1

    def tick(self, message: Received) -> None:
        """Take a tick of the clock.

        Parameters
        ----------
        message : Received
            The ``rosgraph_msgs/msg/Clock`` as CDR.
        """
        wall_ns = _sent_ns(message)
        if message.writer != self._clock:
            if self._clock is not None and wall_ns - self._ticked_ns < _SILENT_NS:
                return
            self._clock = message.writer
        self._ticked_ns = wall_ns
        seconds, nanoseconds = _TIME.unpack_from(message.data, 4)
        now_ns = seconds * _SECOND_NS + nanoseconds
        if self._times and now_ns < self._times[-1]:
            self._offset_ns = self._last_ns - now_ns
            self._walls.clear()
            self._times.clear()
        if not self._times or (now_ns > self._times[-1] and wall_ns > self._walls[-1]):
            self._walls.append(wall_ns)
            self._times.append(now_ns)
            del self._walls[:-_KEPT], self._times[:-_KEPT]

    def stamp_ns(self, message: Received) -> int:
        """Return the stamp of a message; it never runs back."""
        return self.now_ns(_sent_ns(message))

    def now_ns(self, wall_ns: int) -> int:
        """Return the simulated time at a wall time; it never runs back."""
        walls, times = self._walls, self._times
        after = bisect_right(walls, wall_ns)
        if after == 0:
            now_ns = times[0]
        elif after < len(walls):
            (wall, next_wall), (time, next_time) = (
                each[after - 1 : after + 1] for each in (walls, times)
            )
            now_ns = time + (next_time - time) * (wall_ns - wall) // (next_wall - wall)
        else:
            now_ns = times[-1] + self._since_last(wall_ns)
        self._last_ns = max(self._last_ns, self._offset_ns + now_ns)
        return self._last_ns

    def _since_last(self, wall_ns: int) -> int:
        """Return how much simulated time has passed since the newest tick, at most a tick [ns]."""
        walls, times = self._walls[-_TICKS:], self._times[-_TICKS:]
        speed = (times[-1] - times[0]) / max(1, walls[-1] - walls[0])
        tick = (times[-1] - times[0]) / max(1, len(times) - 1)
        return round(min((wall_ns - walls[-1]) * speed, tick))


def _sent_ns(message: Received) -> int:
    """Return when a message was sent; if that is implausible, when it arrived."""
    transport_ns = message.wall_ns - message.sent_ns
    return message.sent_ns if 0 <= transport_ns <= _LATEST_NS else message.wall_ns
