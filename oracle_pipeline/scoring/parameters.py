"""The parameters of nodes, as far as a recording tells them.

A node of ROS 2 reports on ``/parameter_events`` what it declares and what is set. Only a recorder
that runs before the node starts gets the declared values.
"""

import zlib
from collections.abc import Iterable
from typing import Any, TypeAlias

from oracle_pipeline.bags.types import typestore

Parameters: TypeAlias = dict[str, float | str]

EVENTS = "rcl_interfaces/msg/ParameterEvent"
_VALUE = "rcl_interfaces/msg/ParameterValue"
_LONGEST = 60  # characters of a value, before it is cut


def parameters_of(events: Iterable[bytes]) -> Parameters:
    """Return the last value of each parameter, named by node and parameter.

    Parameters
    ----------
    events : iterable of bytes
        Messages of type `EVENTS`, in order of time.
    """
    found: Parameters = {}
    fields = [name for name, _ in typestore().fielddefs[_VALUE][1]]  # in the order of the types
    for data in events:
        event: Any = typestore().deserialize_cdr(data, EVENTS)
        for each in (*event.new_parameters, *event.changed_parameters):
            if 0 < each.value.type < len(fields):  # 0: it has no value
                value = getattr(each.value, fields[each.value.type])
                found[f"{event.node} {each.name}"] = _as_number_or_text(value)
    return found


def _as_number_or_text(value: Any) -> float | str:
    if isinstance(value, bool | int | float):
        return float(value)
    text = value if isinstance(value, str) else ", ".join(str(each) for each in value)
    if len(text) <= _LONGEST:
        return text
    return f"{text[:_LONGEST]}... ({zlib.crc32(text.encode(errors='replace')):08x})"
