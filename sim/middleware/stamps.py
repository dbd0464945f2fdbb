"""Time and header messages from nanoseconds of simulated time."""

from typing import Any

from oracle_pipeline.bags.types import message_class

_Time = message_class("builtin_interfaces/msg/Time")
_Duration = message_class("builtin_interfaces/msg/Duration")
_Header = message_class("std_msgs/msg/Header")


def time_message(time_ns: int) -> Any:
    """Return ``builtin_interfaces/msg/Time``."""
    return _Time(*divmod(time_ns, 1_000_000_000))


def duration_message(duration_ns: int) -> Any:
    """Return ``builtin_interfaces/msg/Duration``."""
    return _Duration(*divmod(duration_ns, 1_000_000_000))


def header(time_ns: int, frame_id: str) -> Any:
    """Return ``std_msgs/msg/Header``."""
    return _Header(_Time(*divmod(time_ns, 1_000_000_000)), frame_id)


def stamp_ns(stamp: Any) -> int:
    """Return a time or duration message in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
