"""How far goals have come, as the program that gives them knows."""

from dataclasses import dataclass
from typing import Literal, Protocol

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


class Commander(Protocol):
    """A program that gives goals one after another."""

    results: list[GoalProgress]  # of the goals so far
    is_over: bool  # whether the last one has ended
