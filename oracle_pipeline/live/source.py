"""Where a watch gets its messages from."""

from abc import ABC, abstractmethod
from typing import Any

from oracle_pipeline.bags.discovery import Discovery
from oracle_pipeline.live.intake import Intake
from oracle_pipeline.live.machine import Machine

_PAUSE_S = 0.05  # between two reads of the queue; waking up for each message costs more


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
        self._machine = Machine()

    def pause(self) -> bool:
        """Let messages come; return whether the machine is too busy for their times to count."""
        return self._machine.pause(_PAUSE_S)

    def calls(self) -> int:
        """Return how often it was asked to keep the time around now, since the last call."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Stop receiving, and leave."""
