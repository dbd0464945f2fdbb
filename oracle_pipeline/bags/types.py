"""ROS 2 message types: Humble's, and those that Humble's type store lacks.

Their fields are in ``fields.json``, which the module ``interfaces`` writes: parsing all interface
files takes longer than reading a short recording. Bytes are CDR with its four-byte encapsulation
header, as in a bag.
"""

import functools
import json
from importlib.resources import files
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.errors import BagError

GROUND_TRUTH_TOPIC = "/_oracle/ground_truth"
GROUND_TRUTH_TYPE = "oracle_msgs/msg/GroundTruth"

_FIELDS = "fields.json"


class TypeDefinition(NamedTuple):
    """The definition of a message type in a bag."""

    text: str  # of .msg or .idl files, with all types that it uses; empty: not in the bag
    type_hash: str  # RIHS01_...; empty: not in the bag


class _BuiltIn(Typestore):
    """Has the fields of all types, and creates the class of a type on first use."""

    def __init__(self, fielddefs: dict[str, Any]) -> None:
        super().__init__()
        self.fielddefs = fielddefs
        self.types = _Classes(fielddefs)


class _Classes(dict[str, type[Any]]):
    def __init__(self, fielddefs: dict[str, Any]) -> None:
        super().__init__()
        self._fielddefs = fielddefs

    def __missing__(self, msgtype: str) -> type[Any]:
        store = Typestore()
        store.register({msgtype: self._fielddefs[msgtype]})
        self[msgtype] = store.types[msgtype]
        return self[msgtype]


@functools.cache
def typestore() -> Typestore:
    """Return the shared type store; treat it as read-only."""
    return _BuiltIn(fields_from_text(files(__package__).joinpath(_FIELDS).read_text("utf8")))


def fields_from_text(text: str) -> dict[str, Any]:
    """Return the fields of types, as rosbags has them, from JSON."""

    def kind(node: Any) -> Any:
        number, what = node
        if isinstance(what, str):
            return Nodetype(number), what
        if number == Nodetype.BASE:
            return Nodetype.BASE, tuple(what)
        return Nodetype(number), (kind(what[0]), what[1])

    return {
        name: (
            [tuple(constant) for constant in constants],
            [(field, kind(node)) for field, node in fields],
        )
        for name, (constants, fields) in json.loads(text).items()
    }


@functools.cache
def message_class(msgtype: str) -> type[Any]:
    """Return the dataclass of a message type such as ``sensor_msgs/msg/LaserScan``.

    Raises
    ------
    BagError
        If the type is in neither store.
    """
    try:
        return typestore().types[msgtype]
    except KeyError:
        raise BagError(
            f"Message type {msgtype!r} is unknown; add its definition to oracle_pipeline/bags/msg, "
            "and run `python -m tools.message_types`."
        ) from None


def serialize(message: Any, msgtype: str) -> bytes:
    """Return ``message`` as CDR bytes, encapsulation header included."""
    return bytes(typestore().serialize_cdr(message, msgtype, little_endian=True))


def deserialize(data: bytes, msgtype: str) -> Any:
    """Return the message in CDR bytes; for messages of a bag use ``BagReader.deserialize``."""
    return typestore().deserialize_cdr(data, msgtype)


@functools.cache
def definition(msgtype: str) -> str:
    """Return the definition of a type and all it uses, as rosbag2 stores it in a bag.

    References between types have no middle part in this format (``nav2_msgs/Spin_Goal``), which
    the type store can only write for ``/msg/`` types; so a renamed copy is used.
    """
    message_class(msgtype)
    text, _ = _renamed().generate_msgdef(_as_msg(msgtype), ros_version=2)
    return text


@functools.cache
def type_hash(msgtype: str) -> str:
    """Return the type description hash (REP 2011), ``RIHS01_...``."""
    message_class(msgtype)
    return typestore().hash_rihs01(msgtype)


@functools.cache
def _renamed() -> Typestore:
    def rename(node: Any) -> Any:
        if isinstance(node, str):
            return _as_msg(node)
        if isinstance(node, tuple):
            return tuple(rename(part) for part in node)
        return node

    store = Typestore()
    store.fielddefs = {
        _as_msg(name): (constants, [(field, rename(kind)) for field, kind in fields])
        for name, (constants, fields) in typestore().fielddefs.items()
    }
    return store


def _as_msg(msgtype: str) -> str:
    return msgtype.replace("/action/", "/msg/").replace("/srv/", "/msg/")
