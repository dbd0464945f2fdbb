"""Parameters of a node that others may set while it runs, and the event that reports it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.middleware.endpoints import Publisher
from sim.middleware.stamps import time_message

EVENT = "rcl_interfaces/msg/ParameterEvent"
_Event, _Parameter, _Value = map(
    message_class, (EVENT, "rcl_interfaces/msg/Parameter", "rcl_interfaces/msg/ParameterValue")
)
_INTEGER, _DOUBLE = 2, 3  # rcl_interfaces/msg/ParameterType


@dataclass(slots=True, eq=False)
class NodeParameter:
    """A number of a node that may be set while it runs.

    Parameters
    ----------
    node, name
        The node, and the parameter's name there.
    value
        The current value.
    checked
        Returns a value converted to the parameter's type, or raises an `OracleError`.
    changed
        Takes a new value.
    events
        The publisher that reports a parameter that was set.
    """

    node: str
    name: str
    value: float
    checked: Callable[[float], float]
    changed: Callable[[float], None]
    events: Publisher

    def set(self, value: float) -> None:
        """Set it and publish the event, as its node's service ``set_parameters`` does.

        Raises
        ------
        OracleError
            It cannot have that value.
        """
        self.value = self.checked(value)
        self.changed(self.value)
        stamp = time_message(self.events.executor.now_ns)
        reported = _Parameter(self.name, _value(self.value))
        self.events.publish(_Event(stamp, self.node, [], [reported], []))


def _value(number: float) -> object:
    """Return ``rcl_interfaces/msg/ParameterValue``."""
    whole = isinstance(number, int)
    empty: tuple[object, ...] = (
        np.zeros(0, np.uint8), np.zeros(0, np.bool_), np.zeros(0, np.int64), np.zeros(0), [],
    )  # fmt: skip
    return _Value(
        _INTEGER if whole else _DOUBLE, False, int(number) if whole else 0,
        0.0 if whole else float(number), "", *empty,
    )  # fmt: skip
