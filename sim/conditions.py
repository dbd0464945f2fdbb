"""Conditions of a testbed's world that a scenario may change: faults, damage, loads, errors.

A scenario sets them with ``set_parameters`` on the node ``/world``, from its onset to its end.
They are no messages: no topic, graph or event shows them.
"""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

from oracle_pipeline.bags.errors import OracleError
from sim.fuzzing.scenario import WORLD
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.node_parameters import EVENT, NodeParameter


class Range(NamedTuple):
    """Usual value of a condition, and the bounds of others."""

    usual: float
    low: float
    high: float


class ConditionError(OracleError):
    """A condition cannot have this value."""


def declare(
    domain: Domain, conditions: Mapping[str, Range], changed: Callable[[str, float], None]
) -> None:
    """Let scenarios set conditions.

    Parameters
    ----------
    domain
        Domain of the scenario.
    conditions
        The conditions by name.
    changed
        Takes the name of a condition and its new value.
    """
    unseen = domain.add_publisher(WORLD, EVENT, "/_world/parameter_events", qos.PARAMETER_EVENTS)
    for name, values in conditions.items():
        check, change = functools.partial(_checked, name, values), functools.partial(changed, name)
        domain.add_parameter(NodeParameter(WORLD, name, values.usual, check, change, unseen))


def _checked(name: str, values: Range, value: float) -> float:
    if not values.low <= value <= values.high:
        raise ConditionError(f"{name} is from {values.low:g} to {values.high:g}, not {value:g}")
    return float(value)
