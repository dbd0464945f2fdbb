"""The objectives of a search, as values for an optimiser."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from assets.search.closed_loop import Finding

Direction: TypeAlias = Literal["minimize", "maximize"]
ObjectiveName: TypeAlias = Literal["evade", "break", "boundary"]
_BEYOND_ALL = 1e9
_ENOUGH = 3.0  # larger effects do not count: a stuck robot is not informative


@dataclass(frozen=True, slots=True)
class Objective:
    """The objective of a search.

    Attributes
    ----------
    directions : tuple of str
        `maximize` or `minimize`, for each value.
    values : callable
        Takes a finding and the false positive rate of the oracle, and returns the values.
    text : str
        A description for people.
    wants_detected : bool
        Whether only runs that the oracle detects count.
    screens : bool
        Whether trials that are detected in an altered recording are not run.
    """

    directions: tuple[Direction, ...]
    values: Callable[[Finding], tuple[float, ...]]
    text: str
    wants_detected: bool = False
    screens: bool = False


def _ordered(value: float | None) -> float:
    """Return a sortable number; None becomes larger than all others."""
    return _BEYOND_ALL if value is None or not math.isfinite(value) else value


def _symlog(value: float) -> float:
    value = _ordered(value)
    return math.copysign(math.log1p(abs(value)), value)


def _evasion(finding: Finding) -> tuple[float, float]:
    """Return the bounded effect, and how clearly the oracle detects the run.

    Without bounds, the front would consist of stuck robots, which every oracle detects, and of
    attacks without an effect.
    """
    effect = min(_ordered(finding.effect), _ENOUGH)
    return effect, 0.0 if finding.passed else _symlog(finding.score)


OBJECTIVES: Mapping[ObjectiveName, Objective] = {
    "evade": Objective(
        ("maximize", "minimize"),
        _evasion,
        "an effect on the task that the oracle misses, or else at the smallest score",
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
