"""Values of a scenario's parameters: as typed, or along a sweep, by default of its magnitude."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from oracle_pipeline.bags.errors import OracleError
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.program import Parameter, Program
from sim.fuzzing.value_types import Boolean, Number
from sim.testbed import Mode

MAX_VALUES = 1000  # of a sweep

_NUMBER = r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?"
_SWEEP = re.compile(rf"(\w+)=({_NUMBER}):({_NUMBER}):([0-9]+)(:log)?", re.IGNORECASE)
_WORDS = {"true": True, "false": False}

_TABLE = Path(__file__).with_name("magnitudes.yaml")
BUILT_IN: Mapping[str, str | None] = yaml.safe_load(_TABLE.read_text("utf-8"))
"""The sweep of the magnitude of each built-in attack; None of those without a magnitude."""

_VALUES = 8  # of a number without a magnitude


class ParameterError(OracleError):
    """The description of parameter values is invalid."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """The values of one parameter; the others keep theirs."""

    parameter: str
    values: tuple[float, ...]


def typed(program: Program, words: Iterable[str]) -> dict[str, Any]:
    """Return values that were typed as ``name=value``; ``Program.start`` checks them.

    Raises
    ------
    ParameterError
        If there is no ``=``.
    """
    values: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise ParameterError(f"expected name=value, found {word!r}.")
        parameter = program.parameters.get(name)
        values[name] = text if parameter is None else _typed(parameter, text)
    return values


def _typed(parameter: Parameter, text: str) -> Any:
    """Return a text converted to the parameter's type, or unchanged if that is impossible."""
    match parameter.type:
        case Boolean():
            return _WORDS.get(text, text)
        case Number() as kind:
            try:
                return int(text) if kind.is_integer else float(text)
            except ValueError:
                return text
    return text


def sweep(mode: Mode, text: str) -> Sweep:
    """Return the sweep that ``name=low:high:count`` or ``name=low:high:count:log`` describes.

    Values have six significant digits, so that they read well in an index.

    Raises
    ------
    ParameterError
        If the text has another form, or the parameter cannot have a value.
    """
    match = _SWEEP.fullmatch(text)
    if match is None:
        raise ParameterError(
            f"expected name=low:high:count, followed by :log for equal ratios, found {text!r}."
        )
    name, low, high, count = match[1], float(match[2]), float(match[3]), int(match[4])
    program = compile_scenario(mode.scenario, allow_actuation=True)
    parameter = program.parameters.get(name)
    if parameter is None:
        known = ", ".join(program.parameters) or "none"
        raise ParameterError(f"{mode.id} has no parameter {name}; it has {known}.")
    if not isinstance(parameter.type, Number):
        raise ParameterError(f"{name} is a {parameter.type}; only numbers have sweeps.")
    if not 1 <= count <= MAX_VALUES:
        raise ParameterError(f"{name}: expected 1 to {MAX_VALUES} values, found {count}.")
    if match[5] and not (low > 0.0 and high > 0.0):
        raise ParameterError(f"{name}: equal ratios need ends above 0, found {low:g} to {high:g}.")
    space = np.geomspace if match[5] else np.linspace
    rounded = [float(f"{value:.6g}") for value in space(low, high, count)]
    values = [round(value) if parameter.type.is_integer else value for value in rounded]
    try:
        return Sweep(name, tuple(dict.fromkeys(map(parameter.checked, values))))
    except ValueError as error:
        raise ParameterError(f"{name}: {error}.") from error


def sweeps_of(mode: Mode) -> list[Sweep]:
    """Return the sweeps of a scenario: those of a built-in one, or else of each bounded number.

    Raises
    ------
    ParameterError
        If there is nothing to sweep.
    """
    if text := BUILT_IN.get(mode.id):
        return [sweep(mode, text)]
    if mode.id in BUILT_IN:
        raise ParameterError(f"{mode.id} has no magnitude; sweep a parameter with --over.")
    program = compile_scenario(mode.scenario, allow_actuation=True)
    found = [
        sweep(mode, f"{name}={parameter.low!r}:{parameter.high!r}:{_VALUES}")
        for name, parameter in program.parameters.items()
        if isinstance(parameter.type, Number)
        and name not in mode.scenario.drawn
        and parameter.low is not None
        and parameter.high is not None
    ]
    if not found:
        raise ParameterError(
            f"{mode.id} has no number with a min and a max; sweep a parameter with --over."
        )
    return found


def ranges(document: Mapping[str, Any]) -> dict[str, str]:
    """Return default and range of each parameter of a scenario as text: ``0.1 (0 to 1 m)``."""
    return {name: _range(spec) for name, spec in document.get("parameters", {}).items()}


def _range(spec: Mapping[str, Any]) -> str:
    low, high, unit = spec.get("min"), spec.get("max"), spec.get("unit", "")
    bounds = {
        (True, True): f"{low} to {high}",
        (True, False): f"from {low}",
        (False, True): f"to {high}",
    }.get((low is not None, high is not None), "")
    within = " ".join(filter(None, [bounds, unit]))
    drawn = " (drawn for each block unless you set it)" if "drawn" in spec else ""
    return f"{spec['default']}{f' ({within})' if within else ''}{drawn}"
