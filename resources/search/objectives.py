"""What a search looks for, by name, as values that an optimiser orders."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from resources.search.closed_loop import Finding

Direction: TypeAlias = Literal["minimize", "maximize"]


@dataclass(frozen=True, slots=True)
class Objective:
    """What a search looks for.

    Attributes
    ----------
    directions : tuple of str
        Of each value.
    values : callable
        Takes a finding and returns the values.
    wants_detected : bool
        Whether only runs that the oracle detects count.
    screens : bool
        Whether a trial can be given up if its altered messages are detected without a run.
    text : str
        What is looked for, for people.
    """

    directions: tuple[Direction, ...]
    values: Callable[[Finding], tuple[float, ...]]
    text: str
    wants_detected: bool = False
    screens: bool = False


def _finite(value: float | None) -> float:
    """Return a number that can be ordered; None is beyond all."""
    return 1e9 if value is None or not math.isfinite(value) else value


OBJECTIVES: Mapping[str, Objective] = {
    "evade": Objective(
        ("maximize", "minimize"),
        lambda finding: (_finite(finding.effect), _finite(finding.score)),
        "the largest effect on the task at the smallest score",
        screens=True,
    ),
    "break": Objective(
        ("maximize",), lambda finding: (_finite(finding.effect),), "the largest effect on the task"
    ),
    "boundary": Objective(
        ("minimize",),
        lambda finding: (_finite(finding.magnitude),),
        "the smallest change of a message that is detected",
        wants_detected=True,
    ),
}
