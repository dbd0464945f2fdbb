"""QoS profiles: their compatibility, and their form in a bag.

In a bag they are a YAML string with numbers (Humble) or words (Jazzy and later).
A bag has sixty topics and a handful of distinct profiles, so each text is parsed once.
"""

import functools
from enum import Enum
from typing import Any, TypeVar

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from oracle_pipeline.bags import bounded_yaml

_E = TypeVar("_E", bound=Enum)


@functools.lru_cache(maxsize=1024)
def parse(profiles: str) -> tuple[Qos, ...]:
    """Return the profiles in a text, one for each publisher.

    Raises
    ------
    ValueError
        If it is not a list of profiles.
    """
    if not profiles.strip():
        return ()
    listed = bounded_yaml.load(profiles)
    if not isinstance(listed, list) or not all(isinstance(each, dict) for each in listed):
        raise ValueError("QoS profiles are not a list of profiles")
    return tuple(_profile(each) for each in listed)


def is_latched(qos: Qos) -> bool:
    """Return whether a late subscriber gets the last samples."""
    return qos.durability is QosDurability.TRANSIENT_LOCAL


def is_reliable(qos: Qos) -> bool:
    """Return whether lost samples are sent again."""
    return qos.reliability is not QosReliability.BEST_EFFORT


def compatible(offered: Qos, requested: Qos) -> bool:
    """Return whether a publisher's offer meets a subscriber's request (the DDS rule)."""
    too_lossy = is_reliable(requested) and not is_reliable(offered)
    return not too_lossy and (is_latched(offered) or not is_latched(requested))


def _profile(given: dict[Any, Any]) -> Qos:
    return Qos(
        _member(QosHistory, given.get("history")),
        _integer(given.get("depth")),
        _member(QosReliability, given.get("reliability")),
        _member(QosDurability, given.get("durability")),
        _time(given.get("deadline")),
        _time(given.get("lifespan")),
        _member(QosLiveliness, given.get("liveliness")),
        _time(given.get("liveliness_lease_duration")),
        bool(given.get("avoid_ros_namespace_conventions")),
    )


def _member(kind: type[_E], value: object) -> _E:
    """Return a policy by its number or its name; UNKNOWN if it is neither."""
    for member in kind:
        if value == member.value or (isinstance(value, str) and value.upper() == member.name):
            return member
    return kind["UNKNOWN"]


def _time(value: object) -> QosTime:
    if not isinstance(value, dict):
        return QosTime(0, 0)
    return QosTime(_integer(value.get("sec")), _integer(value.get("nsec")))


def _integer(value: object) -> int:
    return value if isinstance(value, int) else 0
