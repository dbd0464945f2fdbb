"""Fields of type ``wstring``, which the type store does not support.

There are two encodings, and a bag does not state which it has: up to ROS 2 Iron the number of
characters and 4 bytes for each, since Jazzy (DDS-XTypes) the number of bytes and UTF-16. Its
encoding is the one that decodes to exactly the length of the message.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

_CHARACTERS, _BYTES = "oracle_msgs/msg/WideCharacters", "oracle_msgs/msg/WideBytes"

#: Definitions that stand for a wide string, by their names, the older encoding first.
ENCODINGS: Final[Mapping[str, Any]] = {
    name: get_types_from_msg(f"{element}[] units\n", name)[name]
    for name, element in ((_CHARACTERS, "uint32"), (_BYTES, "uint8"))
}

_BOUND = re.compile(r"\bwstring<=\d+")


def unbounded(text: str) -> str:
    """Return a definition without the bounds of wide strings; they do not change the bytes."""
    return _BOUND.sub("wstring", text)


def with_wide_strings(parsed: Mapping[str, Any], encoding: str) -> dict[str, Any]:
    """Return definitions with wide strings replaced by those of one encoding."""

    def known(kind: Nodetype, what: Any) -> tuple[Nodetype, Any]:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            return kind, (known(*what[0]), what[1])
        is_wide = _is_wide(kind, what)
        return (Nodetype.NAME, encoding) if is_wide else (kind, what)

    return {
        name: (constants, [(field, known(*each)) for field, each in fields])
        for name, (constants, fields) in parsed.items()
    }


def has_wide_strings(parsed: Mapping[str, Any]) -> bool:
    """Return whether one of some types has a field that is a wide string."""
    return any(
        _is_wide(*(what[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, what)))
        for _, fields in parsed.values()
        for _, (kind, what) in fields
    )


def either(*decoders: Callable[[bytes, str], Any]) -> Callable[[bytes, str], Any]:
    """Return a function that decodes by the first of some that fits, with wide strings as text."""

    def decode(data: bytes, msgtype: str) -> Any:
        order = "le" if data[1:2] == b"\x01" else "be"
        for decoder in decoders[:-1]:
            try:
                return _as_text(decoder(data, msgtype), order)
            except Exception:  # noqa: S112 -- a generated decoder may raise any error
                continue
        return _as_text(decoders[-1](data, msgtype), order)

    return decode


def _is_wide(kind: Nodetype, what: Any) -> bool:
    if kind == Nodetype.NAME:
        return str(what).endswith("/wstring")
    return kind == Nodetype.BASE and what[0] == "wstring"


def _as_text(value: Any, order: str) -> Any:
    """Return a message, or part of it, with its wide strings as ``str``."""
    if isinstance(value, list):
        return [_as_text(each, order) for each in value]
    msgtype = getattr(value, "__msgtype__", None)
    if msgtype is None:
        return value
    if msgtype == _BYTES:
        return bytes(value.units).decode(f"utf-16-{order}")
    if msgtype == _CHARACTERS:  # each is a unit of UTF-16, or a whole character
        text = "".join(map(chr, value.units.tolist()))
        return text.encode("utf-16", "surrogatepass").decode("utf-16")
    for field in dataclasses.fields(value):
        setattr(value, field.name, _as_text(getattr(value, field.name), order))
    return value
