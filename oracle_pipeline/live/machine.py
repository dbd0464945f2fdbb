"""Whether the machine of the watch is too busy for times of messages to mean anything.

Then messages are late here; and if the robot's programs are on the same machine, they are late
there, too. A program that computes starves sooner than the watch, which mostly sleeps, so the
pressure that Linux measures counts as well (``/proc/pressure/cpu``).
"""

import contextlib
from pathlib import Path
from time import monotonic, sleep

_LATE_S = 0.05  # by which a pause is too long, at least
_SHARE = 0.75  # of a second, in which some program waits for a processor
_EVERY_S = 1.0


class Machine:
    """Measures a machine while the watch pauses."""

    def __init__(self) -> None:
        self._is_crowded = False
        self._measured_s, self._waited_s = monotonic(), _waited_s()

    def pause(self, seconds: float) -> bool:
        """Let others work, and return whether the machine is too busy."""
        began_s = monotonic()
        sleep(seconds)
        now_s = monotonic()
        if (passed_s := now_s - self._measured_s) >= _EVERY_S:
            before_s, self._waited_s, self._measured_s = self._waited_s, _waited_s(), now_s
            self._is_crowded = self._waited_s - before_s > _SHARE * passed_s
        return self._is_crowded or now_s - began_s - seconds > _LATE_S


def _waited_s() -> float:
    """Return for how long some program has waited for a processor; 0 if it is not known."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path("/proc/pressure/cpu").read_text().split("total=")[1].split()[0]) * 1e-6
    return 0.0
