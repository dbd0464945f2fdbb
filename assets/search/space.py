"""The search space: the numbers of a scenario that have bounds."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import optuna

from oracle_pipeline.bags.errors import OracleError
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.value_types import Boolean, Number
from sim.testbed import Mode

RATIO_FOR_LOG = 100.0  # ratio of the bounds from which the scale is logarithmic

_NUMBER = r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?"
_RANGE = re.compile(rf"(\w+)=({_NUMBER}):({_NUMBER})", re.IGNORECASE)


class SearchError(OracleError):
    """The description of a search is invalid."""


@dataclass(frozen=True, slots=True)
class Dimension:
    """One varied parameter, with its inclusive bounds (on the magnitude if it is signed)."""

    name: str
    low: float
    high: float
    kind: str  # float, int, bool or signed

    @property
    def is_logarithmic(self) -> bool:
        """Whether the scale is logarithmic, because of the ratio of the bounds."""
        is_float = self.kind in ("float", "signed")
        return is_float and self.low > 0.0 and self.high / self.low >= RATIO_FOR_LOG

    def suggest(self, trial: optuna.Trial) -> Any:
        """Return the value that a trial proposes."""
        if self.kind == "bool":
            return trial.suggest_categorical(self.name, [False, True])
        if self.kind == "int":
            return trial.suggest_int(self.name, math.ceil(self.low), math.floor(self.high))
        value = trial.suggest_float(self.name, self.low, self.high, log=self.is_logarithmic)
        if self.kind == "signed" and trial.suggest_categorical(f"{self.name} < 0", [False, True]):
            return -value
        return value


def search_space(mode: Mode, ranges: Sequence[str] = ()) -> tuple[Dimension, ...]:
    """Return the parameters of a scenario that can be varied.

    Numbers with a min and a max, and booleans, are varied. A parameter that is drawn by block is
    varied only if a range is given for it.

    Parameters
    ----------
    mode : Mode
        Of the scenario.
    ranges : sequence of str
        ``name=low:high``: narrower bounds, or bounds of a parameter that is fixed by default.

    Raises
    ------
    SearchError
        A range is invalid or outside the scenario's bounds, or nothing can be varied.
    """
    program = compile_scenario(mode.scenario, allow_actuation=True)
    given = dict(_read(text) for text in ranges)
    if unknown := sorted(set(given) - set(program.parameters)):
        known = ", ".join(program.parameters) or "none"
        raise SearchError(f"{mode.id} has no parameter {unknown[0]}; it has {known}.")
    found = []
    for name, parameter in program.parameters.items():
        low, high = given.get(name, (parameter.low, parameter.high))
        if name in mode.scenario.drawn and name not in given:
            continue
        match parameter.type:
            case Boolean():
                found.append(Dimension(name, 0.0, 1.0, "bool"))
            case Number() as number if low is not None and high is not None:
                least = -math.inf if parameter.low is None else parameter.low
                most = math.inf if parameter.high is None else parameter.high
                if not least <= low < high <= most:
                    raise SearchError(
                        f"{name}: expected bounds within {least:g} to {most:g}, "
                        f"found {low:g} to {high:g}."
                    )
                kind = "int" if number.is_integer else "float"
                found.append(Dimension(name, low, high, kind))
    if not found:
        raise SearchError(
            f"{mode.id} has no parameter to vary: give numbers a min and a max in its file, or "
            "name one with --range NAME=LOW:HIGH."
        )
    return tuple(found)


def _read(text: str) -> tuple[str, tuple[float, float]]:
    match = _RANGE.fullmatch(text)
    if match is None:
        raise SearchError(f"expected NAME=LOW:HIGH, found {text!r}.")
    return match[1], (float(match[2]), float(match[3]))
