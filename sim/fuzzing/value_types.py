"""The value types of the scenario language; expressions have no others.

At run time a ``Number`` is a number of Python or NumPy or an array with one number per element,
a ``Boolean`` likewise, a ``Text`` a string, a ``Record`` a mapping, a ``Message`` a message
object, an ``Array`` an array or a list, and a ``Table`` a mapping from keys to rows.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from oracle_pipeline.bags.types import message_class, typestore

MAX_TEXT = 256  # characters of a string without a bound


@dataclass(frozen=True, slots=True)
class Number:
    """A number.

    Parameters
    ----------
    kind
        The NumPy name of what a field stores, such as ``uint16``; inside an expression there are
        only ``int64`` and ``float64``.
    """

    kind: str

    def __str__(self) -> str:
        return "whole number" if self.is_integer else "number"

    @property
    def is_integer(self) -> bool:
        """Whether it has no fractions, infinities and NaN."""
        return "int" in self.kind


@dataclass(frozen=True, slots=True)
class Boolean:
    """True or false."""

    def __str__(self) -> str:
        return "boolean"


@dataclass(frozen=True, slots=True)
class Text:
    """A string of at most ``max_len`` characters."""

    max_len: int = MAX_TEXT

    def __str__(self) -> str:
        return "text"


@dataclass(frozen=True, slots=True)
class Array:
    """A sequence.

    Parameters
    ----------
    element
        The type of each of its values.
    bound
        The largest length, or None where the message definition gives none.
    fixed
        Whether every value has exactly ``bound`` elements.
    """

    element: "Type"
    bound: int | None = None
    fixed: bool = False

    def __str__(self) -> str:
        return f"array of {self.element}"


@dataclass(frozen=True, slots=True)
class Record:
    """Named values; a mapping at run time."""

    name: str
    fields: "Mapping[str, Type]"

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Message(Record):
    """A ROS message, whose type is its name; an object of its message class at run time."""


@dataclass(frozen=True, slots=True)
class Table:
    """A state table: rows of one shape by a text key, which is stored without padding."""

    row: Record
    max_size: int

    def __str__(self) -> str:
        return "table"


Type = Number | Boolean | Text | Array | Record | Table

INTEGER = Number("int64")
FLOAT = Number("float64")
BOOLEAN = Boolean()


@functools.cache
def message_type(msgtype: str) -> Message:
    """Return the type of a message such as ``sensor_msgs/msg/LaserScan``, nested types included.

    Raises
    ------
    BagError
        If the type store does not know it.
    """
    message_class(msgtype)
    _, fields = typestore().fielddefs[msgtype]
    return Message(msgtype, {name: _field_type(definition) for name, definition in fields})


def _field_type(definition: tuple[Nodetype, Any]) -> Type:
    node, detail = definition
    match node:
        case Nodetype.BASE:
            kind, bound = detail
            return _base_type(kind, bound)
        case Nodetype.NAME:
            return message_type(detail)
        case _:
            element, bound = detail
            return Array(_field_type(element), bound or None, fixed=node is Nodetype.ARRAY)


def _base_type(kind: str, bound: int) -> Type:
    match kind:
        case "bool":
            return BOOLEAN
        case "string" | "wstring":
            return Text(bound or MAX_TEXT)
        case "byte":  # signed, as rosbags reads and writes it
            return Number("int8")
        case "char" | "octet":
            return Number("uint8")
        case _:
            return Number(kind)


def missing(kind: Type) -> Any:
    """Return the value of an absent element, row or field: NaN, 0, false and empty sequences."""
    return _empty(kind, math.nan)


def zero(kind: Type) -> Any:
    """Return the value of a type in which every number is 0 and every sequence empty."""
    return _empty(kind, 0.0)


def _empty(kind: Type, number: float) -> Any:
    match kind:
        case Message(name, fields):
            return message_class(name)(*(_empty(field, number) for field in fields.values()))
        case Record(_, fields):
            return {name: _empty(field, number) for name, field in fields.items()}
        case Array(Number() | Boolean() as element, bound, fixed):
            length = bound or 0 if fixed else 0
            return np.full(length, _empty(element, number), getattr(element, "kind", "bool"))
        case Array(element, bound, fixed):
            return [_empty(element, number) for _ in range(bound or 0)] if fixed else []
        case Table():
            return {}
        case Number():
            return 0 if kind.is_integer else number
        case Boolean():
            return False
    return ""


def strip_padding(text: str) -> str:
    """Return a string as strings are compared: without trailing NULs and spaces."""
    return text.rstrip("\0 ")


def listable(kind: Type) -> Type | None:
    """Return the type of a value as an element of a list, or None."""
    match kind:
        case Number():
            return FLOAT
        case Array(Number(), int() as length, True):
            return Array(FLOAT, length, fixed=True)
    return None


def has_header(kind: Message) -> bool:
    """Return whether messages of a type carry a stamp."""
    header = kind.fields.get("header")
    return isinstance(header, Message) and header.name == "std_msgs/msg/Header"
