"""The time of a recording: simulated time where there is a ``/clock``, else that of the wall.

It is the choice of ``ros2 bag record``: with ``--use-sim-time`` stamps are the robot's own time,
so windows of 10 s are 10 s of the robot, however fast the simulation is. Between two ticks of the
clock, time goes on as fast as it did between the last ticks.
"""

import struct
from collections import deque

CLOCK_TOPIC = "/clock"

_TIME = struct.Struct("<iI")  # seconds, nanoseconds
_TICKS = 20  # of which the speed is taken
_SECOND_NS = 1_000_000_000


class WallTime:
    """The wall's time."""

    is_ready = True

    def hear(self, wall_ns: int, data: bytes) -> None:
        """Hear a tick, which means nothing here."""

    def stamp_ns(self, wall_ns: int) -> int:
        """Return the stamp of a message."""
        return wall_ns


class SimulatedTime:
    """Simulated time, from the ticks of ``/clock``."""

    def __init__(self) -> None:
        self._ticks: deque[tuple[int, int]] = deque(maxlen=_TICKS)  # wall, simulated [ns]
        self._offset_ns = 0  # keeps time from running back when a simulation starts anew
        self._last_ns = 0

    @property
    def is_ready(self) -> bool:
        """Whether there were ticks enough to know the time and its speed."""
        return len(self._ticks) > 1

    def hear(self, wall_ns: int, data: bytes) -> None:
        """Hear a tick.

        Parameters
        ----------
        wall_ns : int
            When it came.
        data : bytes
            The ``rosgraph_msgs/msg/Clock`` as CDR.
        """
        seconds, nanoseconds = _TIME.unpack_from(data, 4)
        now_ns = seconds * _SECOND_NS + nanoseconds
        if self._ticks and now_ns < self._ticks[-1][1]:
            self._offset_ns = self._last_ns - now_ns
            self._ticks.clear()
        if not self._ticks or now_ns > self._ticks[-1][1]:
            self._ticks.append((wall_ns, now_ns))

    def stamp_ns(self, wall_ns: int) -> int:
        """Return the stamp of a message that came at a time of the wall; it never runs back."""
        (first_wall, first), (last_wall, last) = self._ticks[0], self._ticks[-1]
        speed = (last - first) / max(1, last_wall - first_wall)
        ticks = max(1, len(self._ticks) - 1)
        ahead_ns = min((wall_ns - last_wall) * speed, (last - first) / ticks)
        self._last_ns = max(self._last_ns, self._offset_ns + last + round(ahead_ns))
        return self._last_ns
