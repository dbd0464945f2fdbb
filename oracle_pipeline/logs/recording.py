"""Write a log as a rosbag2, with a ROS type where the columns are those of one."""

import functools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import TypeDefinition, message_class, typestore
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.logs.log import Log, LogError, LogTopic

_CDR = np.frombuffer(b"\x00\x01\x00\x00", np.uint8)  # encapsulation: CDR, little-endian
_ROWS = 4096  # messages written at once
MADE_TYPES = "log_msgs/msg/"  # begins the names of types that are made for topics

# The first that fits counts: a table of `linear` and `angular` is a Twist rather than an Accel.
_CANDIDATES = (
    "nav_msgs/msg/Odometry",
    *map("sensor_msgs/msg/{}".format, ("Imu", "NavSatFix", "MagneticField", "LaserScan", "Range")),
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    *map("geometry_msgs/msg/{}Stamped".format, ("Pose", "Twist", "Wrench")),
    *map("geometry_msgs/msg/{}".format, ("Pose", "Twist", "Wrench")),
)


def write_bag(log: Log, bag: Path) -> None:
    """Write the topics of a log as a rosbag2 (MCAP).

    Parameters
    ----------
    log : Log
    bag : Path
        Folder of the bag, which must not exist.

    Raises
    ------
    LogError
        If a topic's columns do not fit its type.
    BagError
        If the bag cannot be written.
    """
    with BagWriter(bag) as writer:
        for topic in log.topics:
            rows, definition = (_typed(topic), None) if topic.msgtype else _made(topic)
            msgtype = topic.msgtype or made_type(topic.name)
            writer.add_topic(topic.name, msgtype, [], definition)
            for begin in range(0, len(rows), _ROWS):
                chunk = rows[begin : begin + _ROWS]
                stamps = topic.times_ns[begin : begin + _ROWS].tolist()
                writer.write_many(
                    [topic.name] * len(chunk), stamps, [row.tobytes() for row in chunk]
                )


def made_type(topic: str) -> str:
    """Return the name of the type that is made for a topic.

    Examples
    --------
    >>> made_type("/data_motor_1")
    'log_msgs/msg/DataMotor1'
    """
    words = re.findall(r"[A-Za-z0-9]+", topic)
    name = "".join(word[0].upper() + word[1:] for word in words)
    return f"{MADE_TYPES}{name if name[:1].isalpha() else f'Topic{name}'}"


def field_name(column: str) -> str:
    """Return a column's name as the name of a field."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", column).strip("_")
    return name if name[:1].isalpha() else f"c_{name}"


def _made(topic: LogTopic) -> tuple[NDArray[Any], TypeDefinition]:
    """Lay out all columns as 64-bit numbers in a type of their own."""
    names = [field_name(column) for column in topic.columns]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise LogError(
            f"{topic.name} has two columns for the field {twice}; rename one in the layout file."
        )
    parts, lines = [], []
    for name, (column, values) in zip(names, topic.columns.items(), strict=True):
        array = np.asarray(values, dtype="<f8").reshape(len(topic.times_ns), -1)
        shape = f"[{array.shape[1]}]" if values.ndim > 1 else ""
        unit = topic.units.get(column, "")
        lines.append(f"float64{shape} {name}{f'  # [{unit}]' if unit else ''}\n")
        parts.append(array)
    numbers = np.concatenate(parts, axis=1).view(np.uint8).reshape(len(topic.times_ns), -1)
    rows = np.concatenate([np.tile(_CDR, (len(numbers), 1)), numbers], axis=1)
    return rows, TypeDefinition("".join(lines), "")


def _typed(topic: LogTopic) -> NDArray[Any]:
    """Lay out the columns as messages of a ROS type; other fields are 0."""
    prototype = _blank(topic.msgtype)
    for path, text in topic.texts.items():
        owner, last = _owner(prototype, path)
        setattr(owner, last, text)
    for path, values in topic.columns.items():
        owner, last = _owner(prototype, path)
        if values.ndim > 1 and len(getattr(owner, last)) == 0:  # a sequence, such as ranges
            setattr(owner, last, np.zeros(values.shape[1], getattr(owner, last).dtype))
    count = len(topic.times_ns)
    columns = dict(topic.columns)
    if hasattr(prototype, "header") and STAMP[0] not in columns:
        columns[STAMP[0]], columns[STAMP[1]] = np.divmod(topic.times_ns, 1_000_000_000)
    try:
        rows = Template(prototype, topic.msgtype, list(columns)).rows(count)
        for path, values in columns.items():
            rows[path] = values
    except (ValueError, KeyError) as error:
        raise LogError(f"{topic.name} does not fit {topic.msgtype}: {error}.") from error
    return rows.view(np.uint8).reshape(count, -1)


def _owner(message: Any, path: str) -> tuple[Any, str]:
    """Return the part of a message that has the field at a path, and the field's name."""
    *parents, last = path.split(".")
    return functools.reduce(getattr, parents, message), last


def _blank(msgtype: str) -> Any:
    """Return a message whose numbers are 0 and whose strings and sequences are empty."""
    values = [_zero(kind) for _, kind in typestore().fielddefs[msgtype][1]]
    return message_class(msgtype)(*values)


def _zero(kind: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return _blank(detail)
    if node == Nodetype.BASE:
        return "" if detail[0] == "string" else 0
    element, length = detail
    length = length if node == Nodetype.ARRAY else 0
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return np.zeros(length, dtype={"byte": "uint8", "char": "uint8"}.get(*2 * [element[1][0]]))
    return [_zero(element) for _ in range(length)]


def _number_paths(msgtype: str) -> Iterator[str]:
    """Yield the fields of a type that hold numbers, such as ``pose.position.x``."""
    for name, (node, detail) in typestore().fielddefs[msgtype][1]:
        of_one = detail[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, detail)
        if node == Nodetype.NAME:
            yield from (f"{name}.{path}" for path in _number_paths(str(detail)))
        elif of_one[0] == Nodetype.BASE and of_one[1][0] != "string":
            yield name


def echoed_columns(count: int) -> list[str]:
    """Return names for so many numbers and texts that ``ros2 topic echo --csv`` wrote in a row.

    They are the fields of the only type that has as many, if there is one.
    """
    rows = [row for row in map(_row, _CANDIDATES) if len(row) == count and row[0] == STAMP[0]]
    unknown = [*STAMP, "header.frame_id", *(f"column_{n}" for n in range(4, count + 1))]
    return rows[0] if len(rows) == 1 else unknown


def _row(msgtype: str) -> list[str]:
    """Return the fields of a type, one for each number or text."""
    row: list[str] = []
    for name, (node, detail) in typestore().fielddefs[msgtype][1]:
        if node == Nodetype.NAME:
            row += [f"{name}.{field}" for field in _row(str(detail))]
        elif node == Nodetype.ARRAY:
            row += [f"{name}_{number}" for number in range(int(detail[1]))]
        else:
            row.append(name)
    return row


def guessed_type(columns: Mapping[str, Any]) -> str:
    """Return the type whose fields the columns are; empty if there is none.

    All numbers of the type must be there but for covariances, intensities and the header, and the
    table must have no other columns. ROS 1's names of the header count.
    """
    names = {name for name in columns if not name.startswith("header.")}
    for msgtype in _CANDIDATES:
        required, known = _fields(msgtype)
        if required <= names <= known:
            return msgtype
    return ""


@functools.cache
def _fields(msgtype: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the fields that a table of a type must have, and all that it may have."""
    paths = frozenset(p for p in _number_paths(msgtype) if not p.startswith("header."))
    optional = {p for p in paths if re.search("covariance|^status\\.|^intensities", p)}
    return paths - optional, paths
