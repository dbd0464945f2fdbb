"""The objectives of a search, by name, as values for an optimiser."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from resources.search.closed_loop import Finding

Direction: TypeAlias = Literal["minimize", "maximize"]
_BEYOND_ALL = 1e9


@dataclass(frozen=True, slots=True)
class Objective:
    """What a search looks for.

    Attributes
    ----------
    directions : tuple of str
        Of each value: `maximize` or `minimize`.
    values : callable
        Takes a finding and returns the values.
    text : str
        A description for people.
    wants_detected : bool
        Whether only runs that the oracle detects count.
    screens : bool
        Whether a trial can be given up if its altered messages are detected without a run.
    """

    directions: tuple[Direction, ...]
    values: Callable[[Finding], tuple[float, ...]]
    text: str
    wants_detected: bool = False
    screens: bool = False


def _ordered(value: float | None) -> float:
    """Return a number that can be ordered; None becomes larger than all others."""
    return _BEYOND_ALL if value is None or not math.isfinite(value) else value


def _symlog(value: float) -> float:
    value = _ordered(value)
    return math.copysign(math.log1p(abs(value)), value)


OBJECTIVES: Mapping[str, Objective] = {
    # By logarithm: a robot that is stuck has effects, and scores, far above all that matter.
    "evade": Objective(
        ("maximize", "minimize"),
        lambda finding: (_symlog(finding.effect), _symlog(finding.score)),
        "the largest effect on the task at the smallest score",
        screens=True,
    ),
    "break": Objective(
        ("minimize",),
        lambda finding: (_ordered(finding.margin),),
        "the clearest violation of a property: goals reached, clear of obstacles, in time",
    ),
    "boundary": Objective(
        ("minimize",),
        lambda finding: (_ordered(finding.magnitude),),
        "the smallest change of a message that is detected",
        wants_detected=True,
    ),
}
