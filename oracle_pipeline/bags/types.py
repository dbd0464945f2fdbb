"""ROS 2 message types: Humble's, and those that Humble's type store lacks.

The missing ones stand below ``msg/`` in ROS's own interface files: ``<package>/msg/*.msg``,
``<package>/srv/*.srv`` and ``<package>/action/*.action``; a service or action file yields the
messages that ROS derives from it (``NavigateToPose_Goal``, ``NavigateToPose_FeedbackMessage``).
Bytes are CDR with its four-byte encapsulation header, as in a bag.
"""

import functools
from collections.abc import Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.errors import BagError

GROUND_TRUTH_TOPIC = "/_oracle/ground_truth"
GROUND_TRUTH_TYPE = "oracle_msgs/msg/GroundTruth"

# IDL has no empty struct, so ROS puts this byte into messages without fields.
_EMPTY = "uint8 structure_needs_at_least_one_member\n"


class TypeDefinition(NamedTuple):
    """What a bag says of a message type."""

    text: str  # that of .msg or .idl files, with all that the type uses; empty: not in the bag
    type_hash: str  # RIHS01_...; empty: not in the bag


@functools.cache
def typestore() -> Typestore:
    """Return the shared type store; treat it as read-only."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(
        {
            name: definition
            for package in files(__package__).joinpath("msg").iterdir()
            for folder in package.iterdir()
            for file in folder.iterdir()
            for msgtype, text in _messages_of(package.name, folder.name, file)
            for name, definition in _parse(msgtype, text).items()
        }
    )
    return store


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
            f"Message type {msgtype!r} is unknown; add its definition to oracle_pipeline/bags/msg."
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
    the type store can only write for ``/msg/`` types; so it is asked about a renamed copy.
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


def _messages_of(package: str, folder: str, file: Traversable) -> Iterator[tuple[str, str]]:
    """Yield name and text of every message that one interface file stands for."""
    name = f"{package}/{folder}/{file.name.partition('.')[0]}"
    parts = [part.strip() + "\n" for part in f"\n{file.read_text('utf8')}\n".split("\n---\n")]
    parts = [_EMPTY if part == "\n" else part for part in parts]
    if folder == "msg":
        yield name, parts[0]
    elif folder == "srv":
        yield from zip((f"{name}_Request", f"{name}_Response"), parts, strict=True)
    else:
        goal, result, feedback = (f"{name}_{part}" for part in ("Goal", "Result", "Feedback"))
        uuid = "unique_identifier_msgs/msg/UUID goal_id\n"
        yield from zip((goal, result, feedback), parts, strict=True)
        yield f"{name}_FeedbackMessage", f"{uuid}{feedback} feedback\n"
        yield f"{name}_SendGoal_Request", f"{uuid}{goal} goal\n"
        yield (
            f"{name}_SendGoal_Response",
            "bool accepted\nbuiltin_interfaces/msg/Time stamp\n",
        )
        yield f"{name}_GetResult_Request", uuid
        yield f"{name}_GetResult_Response", f"int8 status\n{result} result\n"


def _parse(msgtype: str, text: str) -> dict[str, Any]:
    """Parse one message; the parser knows no ``srv`` names, so those go in as ``msg``."""
    (fields,) = get_types_from_msg(text, msgtype.replace("/srv/", "/msg/")).values()
    return {msgtype: fields}
