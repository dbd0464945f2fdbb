"""What a search may propose: a space of attacks, from which Optuna's trials draw.

A proposal is a complete scenario with the proposed values as defaults. So it can be recorded,
mutated and shared like any other scenario.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution

from oracle_pipeline.bags.errors import OracleError
from sim.pairs import CONTROL


class SearchError(OracleError):
    """The description of a search is invalid."""


@dataclass(frozen=True, slots=True)
class Attack:
    """The proposal of a trial.

    Attributes
    ----------
    document : mapping
        A scenario with the values as defaults.
    values : mapping of str to number or text
        The proposed values, by name.
    """

    document: Mapping[str, Any]
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class AttackSpace:
    """The attacks that a search may propose.

    Attributes
    ----------
    id : str
        Name of its scenarios.
    text : str
        A description for people.
    suggest : callable
        Returns the attack that a trial proposes.
    conditions : mapping
        Changes to the testbed.
    control : str
        Mode of the runs without an attack.
    """

    id: str
    text: str
    suggest: Callable[[optuna.Trial], Attack]
    conditions: Mapping[str, Any] = field(default_factory=dict)
    control: str = CONTROL


def suggested(trial: optuna.Trial, name: str, values: BaseDistribution) -> Any:
    """Return the value that a trial proposes: a number within bounds, or a yes or no."""
    match values:
        case FloatDistribution():
            return trial.suggest_float(name, values.low, values.high, log=values.log)
        case IntDistribution():
            return trial.suggest_int(name, values.low, values.high)
        case _:
            return trial.suggest_categorical(name, [False, True])
