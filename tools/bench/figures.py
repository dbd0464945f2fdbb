"""A figure and its goal as one line of text, and the medians behind figures."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One measured figure."""

    name: str
    value: float
    unit: str = ""
    goal: float | None = None
    at_most: bool = True  # the goal is an upper limit; else a lower one
    remark: str = ""

    def __str__(self) -> str:
        """Return the line to print."""
        text = f"{self.name:<56}{self.value:>9.3g} {self.unit}"
        if self.goal is not None:
            met = self.value <= self.goal if self.at_most else self.value >= self.goal
            text += f"   goal: at {'most' if self.at_most else 'least'} {self.goal:g}"
            text += "" if met else "  MISSED"
        return f"{text}  {self.remark}".rstrip()


def spread(values: Sequence[float]) -> str:
    """Return the range of the values behind a median."""
    return f"({len(values)} rounds: {min(values):.3g} to {max(values):.3g})"


median = statistics.median
