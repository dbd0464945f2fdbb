"""Where a watch gets its messages from, and whether its machine is too busy for their times.

Then messages are late here; and if the robot's programs are on the same machine, they are late
there, too. A program that computes starves sooner than the watch, which mostly sleeps, so the
pressure that Linux measures counts as well (``/proc/pressure/cpu``).
"""

import contextlib
from abc import ABC, abstractmethod
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from oracle_pipeline.bags.discovery import Discovery
from oracle_pipeline.live.intake import Intake

_PAUSE_S = 0.05  # between two reads of the queue; waking up for each message costs more
_LATE_S = 0.05  # by which a pause is too long, at least
_STOPPED_S = 1.0  # between ends of pauses, for longer than any work: the program was stopped
_SHARE = 0.75  # of a second, in which some program waits for a processor
_EVERY_S = 1.0


class Source(ABC):
    """A running system as seen from here.

    Parameters
    ----------
    facts : dict
        What ``recording.json`` says of it.
    discovery : Discovery
    intake : Intake
    """

    def __init__(self, facts: dict[str, Any], discovery: Discovery, intake: Intake) -> None:
        self.facts, self.discovery, self.intake = facts, discovery, intake
        self._machine = _Machine()

    def pause(self) -> bool:
        """Let messages come; return whether the machine is too busy for their times to count."""
        return self._machine.pause(_PAUSE_S)

    def calls(self) -> int:
        """Return how often it was asked to keep the time around now, since the last call."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Stop receiving, and leave."""


class _Machine:
    """Measures a machine while the watch pauses."""

    def __init__(self) -> None:
        self._is_crowded = False
        self._measured_s = self._ended_s = self._until_s = monotonic()
        self._waited_s = _waited_s()

    def pause(self, seconds: float) -> bool:
        """Let others work, and return whether the machine is too busy."""
        began_s = monotonic()
        sleep(seconds)
        now_s = monotonic()
        if (passed_s := now_s - self._measured_s) >= _EVERY_S:
            before_s, self._waited_s, self._measured_s = self._waited_s, _waited_s(), now_s
            self._is_crowded = self._waited_s - before_s > _SHARE * passed_s
        if now_s - self._ended_s > _STOPPED_S:  # what came meanwhile is received from now on
            self._until_s = now_s + _EVERY_S
        self._ended_s = now_s
        return self._is_crowded or now_s < self._until_s or now_s - began_s - seconds > _LATE_S


def _waited_s() -> float:
    """Return for how long some program has waited for a processor; 0 if it is not known."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path("/proc/pressure/cpu").read_text().split("total=")[1].split()[0]) * 1e-6
    return 0.0
