"""The objectives of a search, by name, as values for an optimiser."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from resources.search.closed_loop import Finding

Direction: TypeAlias = Literal["minimize", "maximize"]
_BEYOND_ALL = 1e9
_ENOUGH = 3.0  # an effect beyond this counts no more: a robot that is stuck shows nothing new


@dataclass(frozen=True, slots=True)
class Objective:
    """What a search looks for.

    Attributes
    ----------
    directions : tuple of str
        Of each value: `maximize` or `minimize`.
    values : callable
        Takes a finding and the false positive rate of the oracle, and returns the values.
    text : str
        A description for people.
    wants_detected : bool
        Whether only runs that the oracle detects count.
    screens : bool
        Whether a trial can be given up if its altered messages are detected without a run.
    """

    directions: tuple[Direction, ...]
    values: Callable[[Finding, float], tuple[float, ...]]
    text: str
    wants_detected: bool = False
    screens: bool = False


def _ordered(value: float | None) -> float:
    """Return a number that can be ordered; None becomes larger than all others."""
    return _BEYOND_ALL if value is None or not math.isfinite(value) else value


def _symlog(value: float) -> float:
    value = _ordered(value)
    return math.copysign(math.log1p(abs(value)), value)


def _evasion(finding: Finding, far: float) -> tuple[float, float]:
    """Return the effect as far as it matters, and how clearly the oracle detects the run.

    Unbounded, both lead away from what is looked for: the front would consist of robots that are
    stuck, which every oracle detects, and of attacks that do nothing.
    """
    effect = min(_ordered(finding.effect), _ENOUGH)
    return effect, 0.0 if finding.p_value > far else _symlog(finding.score)


OBJECTIVES: Mapping[str, Objective] = {
    "evade": Objective(
        ("maximize", "minimize"),
        _evasion,
        "an effect on the task that the oracle passes, or else at the smallest score",
        screens=True,
    ),
    "break": Objective(
        ("minimize",),
        lambda finding, _: (_ordered(finding.margin),),
        "the clearest violation of a property: goals reached, clear of obstacles, in time",
    ),
    "boundary": Objective(
        ("minimize",),
        lambda finding, _: (_ordered(finding.magnitude),),
        "the smallest change of a message that is detected",
        wants_detected=True,
    ),
}
