"""How far a goal has come, as the program that gave it knows."""

from dataclasses import dataclass
from typing import Literal

GoalOutcome = Literal["succeeded", "aborted", "canceled"]


@dataclass(slots=True)
class GoalProgress:
    """Progress of one goal; a part of a flight is one, too."""

    accepted_ns: int
    ended_ns: int | None = None  # None while it is active
    outcome: GoalOutcome | None = None
    number_of_recoveries: int = 0

    def end(self, now_ns: int, outcome: GoalOutcome) -> None:
        """Note when and how it ended."""
        self.ended_ns, self.outcome = now_ns, outcome
