"""QoS profiles of a bag, parsed and printed once each.

rosbags does it anew for every topic, with a YAML library written in Python, at 2 to 3 ms a topic
and direction. A bag has sixty topics and a handful of distinct profiles, a run opens its bag
several times, and it added up to a tenth of what a short run costs.
"""

import functools
from typing import Any

from rosbags.interfaces import Qos
from rosbags.rosbag2 import reader, storage_mcap, storage_sqlite3, writer
from rosbags.rosbag2.metadata import dump_qos_v8, parse_qos


def remember_profiles() -> None:
    """Let rosbags remember the profiles that it has seen; what it reads and writes is the same."""
    for module, name, function in (
        (reader, "parse_qos", _parse),
        (storage_mcap, "parse_qos", _parse),
        (storage_sqlite3, "parse_qos", _parse),
        (writer, "dump_qos_v8", _dump),
    ):
        setattr(module, name, function)


def _parse(profiles: str | list[Any]) -> list[Qos]:
    if isinstance(profiles, str):
        return list(_parsed(profiles))
    return parse_qos(profiles)


def _dump(profiles: list[Qos]) -> str:
    return _dumped(tuple(profiles))


@functools.lru_cache(maxsize=1024)
def _parsed(profiles: str) -> tuple[Qos, ...]:
    return tuple(parse_qos(profiles))


@functools.lru_cache(maxsize=1024)
def _dumped(profiles: tuple[Qos, ...]) -> str:
    return dump_qos_v8(list(profiles))
