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
