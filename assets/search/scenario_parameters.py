"""The attacks of one scenario: its parameters vary within their bounds."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from assets.search.attack_space import Attack, AttackSpace, SearchError, suggested
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.program import Parameter
from sim.fuzzing.value_types import Boolean, Number
from sim.pairs import control_of
from sim.testbed import Mode

RATIO_FOR_LOG = 100.0  # ratio of the bounds from which the scale is logarithmic

_NUMBER = r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?"
_RANGE = re.compile(rf"(\w+)=({_NUMBER}):({_NUMBER})", re.IGNORECASE)


def scenario_attacks(mode: Mode, ranges: Sequence[str] = ()) -> AttackSpace:
    """Return the attacks of a scenario; see `distributions` for what varies."""
    varied = distributions(mode, ranges)

    def suggest(trial: optuna.Trial) -> Attack:
        values = {name: suggested(trial, name, of) for name, of in varied.items()}
        document = mode.scenario.document
        parameters = {
            name: _fixed(spec, values[name]) if name in values else spec
            for name, spec in document["parameters"].items()
        }
        return Attack({**document, "parameters": parameters}, values)

    text = ", ".join(f"{name} {_in_words(of)}" for name, of in varied.items())
    return AttackSpace(mode.id, text, suggest, mode.conditions, control_of(mode.scenario))


def _fixed(spec: Mapping[str, Any], value: Any) -> dict[str, Any]:
    """Return a parameter with a fixed value instead of a drawn one."""
    kept = {key: what for key, what in spec.items() if key not in ("drawn", "draw")}
    return {**kept, "default": value}


def _in_words(values: BaseDistribution) -> str:
    if isinstance(values, FloatDistribution | IntDistribution):
        return f"{values.low:g} to {values.high:g}"
    return "0 to 1"


def distributions(mode: Mode, ranges: Sequence[str] = ()) -> dict[str, BaseDistribution]:
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
    candidates = {
        name: _distribution(name, parameter, given.get(name, (parameter.low, parameter.high)))
        for name, parameter in program.parameters.items()
        if name in given or name not in mode.scenario.drawn
    }
    found = {name: values for name, values in candidates.items() if values is not None}
    if not found:
        raise SearchError(
            f"{mode.id} has no parameter to vary: give numbers a min and a max in its file, or "
            "name one with --range NAME=LOW:HIGH."
        )
    return found


def _distribution(
    name: str, parameter: Parameter, bounds: tuple[float | None, float | None]
) -> BaseDistribution | None:
    """Return the values that a parameter may have; None if it cannot be varied."""
    low, high = bounds
    if isinstance(parameter.type, Boolean):
        return CategoricalDistribution([False, True])
    if not isinstance(parameter.type, Number) or low is None or high is None:
        return None
    least = -math.inf if parameter.low is None else parameter.low
    most = math.inf if parameter.high is None else parameter.high
    if not least <= low < high <= most:
        raise SearchError(
            f"{name}: expected bounds within {least:g} to {most:g}, found {low:g} to {high:g}."
        )
    if parameter.type.is_integer:
        return IntDistribution(math.ceil(low), math.floor(high))
    return FloatDistribution(low, high, log=low > 0.0 and high / low >= RATIO_FOR_LOG)


def _read(text: str) -> tuple[str, tuple[float, float]]:
    match = _RANGE.fullmatch(text)
    if match is None:
        raise SearchError(f"expected NAME=LOW:HIGH, found {text!r}.")
    return match[1], (float(match[2]), float(match[3]))
