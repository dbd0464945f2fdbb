"""The parameters of nodes, as far as a recording tells them.

A node of ROS 2 reports on ``/parameter_events`` what it declares and what is set. Only a recorder
that runs before the node starts gets the declared values.
"""

import math
import re
import zlib
from collections.abc import Iterable
from typing import Any, NamedTuple, TypeAlias

from oracle_pipeline.bags.types import typestore

Parameters: TypeAlias = dict[str, float | str]

EVENTS = "rcl_interfaces/msg/ParameterEvent"
_VALUE = "rcl_interfaces/msg/ParameterValue"
_LONGEST = 60  # characters of a value, before it is cut
# ROS 2 tools append a suffix to some node names that differs between processes.
PROCESS_SUFFIX = re.compile(r"(?<=_)(?:0x)?[0-9a-f]*\d[0-9a-f]*$")
_TOOLS = ("/_", "/rosbag2_")  # begin the names of nodes of ROS 2 tools


class ReportedParameters(NamedTuple):
    """Parameters by node and name, with ``*`` for what differs between processes."""

    values: Parameters  # the last ones
    changed: frozenset[str]  # those that were set, and not only declared


def parameters_of(events: Iterable[bytes]) -> ReportedParameters:
    """Return the parameters that were reported, but for those of ROS 2 tools.

    Parameters
    ----------
    events : iterable of bytes
        Messages of type `EVENTS`, in order of time.
    """
    found, changed = Parameters(), set[str]()
    fields = [name for name, _ in typestore().fielddefs[_VALUE][1]]  # in the order of the types
    for data in events:
        event: Any = typestore().deserialize_cdr(data, EVENTS)
        if event.node.startswith(_TOOLS):
            continue
        node = PROCESS_SUFFIX.sub("*", event.node)
        for each in (*event.new_parameters, *event.changed_parameters):
            if 0 < each.value.type < len(fields):  # 0: it has no value
                value = getattr(each.value, fields[each.value.type])
                found[f"{node} {each.name}"] = _as_number_or_text(value)
        changed |= {f"{node} {each.name}" for each in event.changed_parameters}
    return ReportedParameters(found, frozenset(changed & found.keys()))


def _as_number_or_text(value: Any) -> float | str:
    if isinstance(value, bool | int | float):
        return float(value) if math.isfinite(value) else str(value)
    text = value if isinstance(value, str) else ", ".join(str(each) for each in value)
    if len(text) <= _LONGEST:
        return text
    return f"{text[:_LONGEST]}... ({zlib.crc32(text.encode(errors='replace')):08x})"
