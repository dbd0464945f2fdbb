"""Takes the numbers out of many messages of one type, each under the name of its field.

A number is treated as what it is. Stamps and texts are left out. A quaternion becomes roll, pitch,
yaw and norm, a covariance its trace. Arrays are signals by label where the message has labels,
and by index if they are short. Of others there are mean, spread, minimum, maximum and the share of
finite numbers. Messages in a sequence count by their name, if they have one, and as means. Of
texts, the values of diagnostics count, if they begin with a number, by part and key. Transforms are
signals by their pair of frames. Their rotations are the axes of the child, because links of an arm
pass the poles, where roll and yaw flip by half a turn.
"""

import functools
import itertools
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.features.engine.columns import Columns
from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s
from oracle_pipeline.features.signals.units import UNITS

MOST_ELEMENTS = 64  # of an array without labels whose elements are signals
MOST_SUMMARISED = 2048  # numbers of an array that its summary samples, spread evenly
SUMMARY = ("mean", "spread", "min", "max", "finite")
_QUATERNION = "geometry_msgs/msg/Quaternion"
_DURATION = "builtin_interfaces/msg/Duration"
_LAYOUT = "std_msgs/msg/MultiArrayLayout"
_POINT_FIELD = "sensor_msgs/msg/PointField"
_HEADER = ("header", (Nodetype.NAME, "std_msgs/msg/Header"))  # of the whole message
_SKIPPED = {"builtin_interfaces/msg/Time", "std_msgs/msg/Header", _LAYOUT, _POINT_FIELD}
_NAME = ("name", (Nodetype.BASE, ("string", 0)))  # of an element, such as a status of diagnostics
_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
_WRITTEN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*[^\W\d]{0,8}%?", re.IGNORECASE)
_LABELS = ("name", "names", "joint_names")  # of arrays in the same message
_LONGEST_LABEL = 120
_MOST_LABELS = 16  # different ones in a topic; more are not those of a robot's parts

Floats: TypeAlias = NDArray[np.float64]
_Field: TypeAlias = tuple[str, str, Floats]  # name, unit, a number for each message


class Numbers(NamedTuple):
    """Numbers of many messages of one topic, in columns of equal length."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: NDArray[np.int64]  # message of each number, ascending
    values: Floats  # shape (n, n_names)
    stamps_s: Floats | None = None  # of the messages' headers, if they have any


def numbers_of(
    messages: Columns, store: Typestore, msgtype: str, most: int, *, static: bool = False
) -> list[Numbers]:
    """Return the numbers of messages of one type.

    Parameters
    ----------
    messages : Columns
        At least one message.
    store : Typestore
        Has the definition of the type.
    msgtype : str
        Of the messages.
    most : int
        Largest number of signals.
    static : bool
        Whether transforms never change: only norms are signals, the contract holds the rest.
    """
    fields = list(itertools.islice(_fields(messages, store, msgtype), most))
    stamps_s = header_stamps_s(messages) if _HEADER in store.fielddefs[msgtype][1] else None
    found = [_together(fields, np.arange(len(messages)), stamps_s)] if fields else []
    return [*found, *_by_label(messages, store, msgtype, most, static)]


def _together(
    fields: Sequence[_Field], rows: NDArray[np.int64], stamps_s: Floats | None = None
) -> Numbers:
    names, units, values = zip(*fields, strict=True)
    return Numbers(names, units, rows, np.column_stack(values), stamps_s)


def _fields(
    messages: Columns, store: Typestore, msgtype: str, path: str = "", unit: str = ""
) -> Iterator[_Field]:
    """Yield the numbers in the fields of a type, in the order of its definition."""
    if msgtype in _SKIPPED:
        return
    if msgtype == _QUATERNION:
        yield from _rotation(messages, path)
        return
    if msgtype == _DURATION:
        yield path, "s", np.asarray(messages.sec + 1e-9 * messages.nanosec, dtype=np.float64)
        return
    definition = store.fielddefs[msgtype][1]
    labels = _labels(messages, store, msgtype)
    for name, (kind, what) in definition:
        own, of = f"{path}.{name}" if path else name, UNITS.get((msgtype, name), unit)
        if kind == Nodetype.NAME:
            yield from _fields(getattr(messages, name), store, str(what), own, of)
        elif kind == Nodetype.BASE:
            if what[0] != "string":
                yield own, of, np.asarray(getattr(messages, name), dtype=np.float64)
        elif what[0][0] == Nodetype.BASE:
            if what[0][1][0] != "string":
                yield from _array(getattr(messages, name), own, of, labels)
        elif not _is_transform(store, str(what[0][1])):  # these are signals by their frames
            part = _each if kind == Nodetype.ARRAY else _means
            yield from part(getattr(messages, name), store, str(what[0][1]), own, len(messages))


def _rotation(q: Columns, path: str) -> Iterator[_Field]:
    (x, y, z, w), norm = _unit(q)
    yield f"{path}.roll", "rad", np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    yield f"{path}.pitch", "rad", np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yield f"{path}.yaw", "rad", np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    yield f"{path}.norm", "1", norm


def _axes(q: Columns, path: str) -> Iterator[_Field]:
    """Yield the directions of a child's x and z axis in the frame of its parent."""
    (x, y, z, w), _ = _unit(q)
    yield f"{path}.x_axis.x", "1", 1.0 - 2.0 * (y * y + z * z)
    yield f"{path}.x_axis.y", "1", 2.0 * (x * y + w * z)
    yield f"{path}.x_axis.z", "1", 2.0 * (x * z - w * y)
    yield f"{path}.z_axis.x", "1", 2.0 * (x * z + w * y)
    yield f"{path}.z_axis.y", "1", 2.0 * (y * z - w * x)
    yield f"{path}.z_axis.z", "1", 1.0 - 2.0 * (x * x + y * y)


def _unit(q: Columns) -> tuple[Floats, Floats]:
    """Return x, y, z and w of quaternions of unit length, shape (4, n), and what they had."""
    numbers = np.stack([getattr(q, name) for name in "xyzw"]).astype(np.float64)
    norm = np.sqrt((numbers * numbers).sum(axis=0))
    return numbers / norm, norm


def _array(arrays: Any, path: str, unit: str, labels: Sequence[str]) -> Iterator[_Field]:
    """Yield the numbers of an array, or its summary if it is long."""
    lengths = np.array([len(each) for each in arrays])
    longest = int(lengths.max(initial=0))
    if not longest:
        return
    if "covariance" in path.rpartition(".")[2]:
        yield f"{path}.trace", "", _traces(arrays)
    elif longest <= MOST_ELEMENTS or longest == len(labels):
        padded = np.full((len(arrays), longest), np.nan)
        for length in np.unique(lengths[lengths > 0]).tolist():
            of_length = np.flatnonzero(lengths == length)
            padded[of_length, :length] = np.stack([arrays[row] for row in of_length.tolist()])
        names = labels if len(labels) == longest else [str(index) for index in range(longest)]
        for name, column in zip(names, padded.T, strict=True):
            yield f"{path}[{name}]", unit, column
    else:
        units = (unit, unit, unit, unit, "1")
        for name, of, column in zip(SUMMARY, units, _summaries(arrays).T, strict=True):
            yield f"{path}.{name}", of, column


def _traces(arrays: Any) -> Floats:
    if arrays.ndim == 2:  # of fixed length
        return np.asarray(arrays[:, :: math.isqrt(arrays.shape[1]) + 1].sum(axis=1), np.float64)
    sides = [math.isqrt(len(each)) for each in arrays]
    return np.array(
        [float(np.sum(each[:: side + 1])) for each, side in zip(arrays, sides, strict=True)]
    )


def _summaries(arrays: Any) -> Floats:
    """Return the `SUMMARY` of each array, shape (n, 5)."""
    found = np.full((len(arrays), len(SUMMARY)), np.nan)
    for row, each in enumerate(arrays):
        some = np.asarray(each[:: 1 + len(each) // MOST_SUMMARISED], dtype=np.float64)
        finite = some[np.isfinite(some)]
        if len(finite):
            found[row, :4] = finite.mean(), finite.std(), finite.min(), finite.max()
        if len(some):
            found[row, 4] = len(finite) / len(some)
    return found


def _each(
    elements: Columns, store: Typestore, msgtype: str, path: str, count: int
) -> Iterator[_Field]:
    """Yield the numbers of each message of an array, such as the motors of a robot."""
    for name, unit, values in _fields(elements, store, msgtype):
        for index, column in enumerate(values.reshape(count, -1).T):
            yield f"{path}[{index}].{name}", unit, column


def _means(
    elements: Columns, store: Typestore, msgtype: str, path: str, count: int
) -> Iterator[_Field]:
    """Yield the length of a sequence of messages, and the means of their numbers."""
    sizes = np.bincount(elements.owners, minlength=count).astype(np.float64)
    yield f"{path}.length", "1", sizes
    if not len(elements):
        return
    for name, unit, values in _fields(elements, store, msgtype):
        yield f"{path}.{name}", unit, np.bincount(elements.owners, values, count) / sizes


def _labels(messages: Columns, store: Typestore, msgtype: str) -> Sequence[str]:
    """Return the labels of the elements of arrays; empty if these messages have no equal ones."""
    texts: Sequence[str] = []
    if ("layout", (Nodetype.NAME, _LAYOUT)) in store.fielddefs[msgtype][1]:
        dimensions = messages.layout.dim
        first = dimensions.owners == dimensions.owners[:1]
        labels = [str(label) for label in dimensions.label[first]] if len(dimensions) else []
        texts = labels[0].replace(",", " ").split() if len(labels) == 1 else labels
    elif len(different := set(_labels_of_each(messages, store, msgtype))) == 1:
        texts = different.pop()
    texts = [_in_name(text) for text in texts]
    return texts if len(set(texts)) == len(texts) and all(texts) else []


@functools.lru_cache(1024)  # messages repeat their few labels
def _in_name(text: object) -> str:
    """Return a text as a part of a column's name, which people read in tables."""
    return printable(" ".join(str(text)[:_LONGEST_LABEL].split())).replace("/", "_")


def _labels_of_each(messages: Columns, store: Typestore, msgtype: str) -> Iterator[tuple[str, ...]]:
    for name, (kind, what) in store.fielddefs[msgtype][1]:
        if name in _LABELS and kind == Nodetype.SEQUENCE and what[0][1][0] == "string":
            yield from getattr(messages, name)
            return


def labelled_alike(messages: Columns, store: Typestore, msgtype: str) -> list[NDArray[np.int64]]:
    """Return the rows of messages with the same labels, such as the joints of arm and gripper."""
    rows: dict[tuple[str, ...], list[int]] = defaultdict(list)
    for row, labels in enumerate(_labels_of_each(messages, store, msgtype)):
        rows[labels].append(row)
    few = 0 < len(rows) <= _MOST_LABELS
    return [np.array(some) for some in rows.values()] if few else [np.arange(len(messages))]


def sequences(names: Iterable[str]) -> tuple[str, ...]:
    """Return what begins the names of numbers in sequences of messages: means, if there are any.

    Examples
    --------
    >>> sequences(["objects.length", "objects.pose.x", "speed"])
    ('objects.',)
    """
    return tuple(name.removesuffix("length") for name in names if name.endswith(".length"))


def _is_transform(store: Typestore, msgtype: str) -> bool:
    return {"transform", "child_frame_id"} <= {name for name, _ in store.fielddefs[msgtype][1]}


def _by_label(
    messages: Columns, store: Typestore, msgtype: str, most: int, static: bool
) -> Iterator[Numbers]:
    """Yield the numbers of transforms by their pair of frames, of other elements by their name."""
    for name, (kind, what) in store.fielddefs[msgtype][1]:
        if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE) or what[0][0] != Nodetype.NAME:
            continue
        each, element = getattr(messages, name), str(what[0][1])
        if _is_transform(store, element):
            parents, children = frame_names(each.header.frame_id), frame_names(each.child_frame_id)
            texts = [f"{p}-{c}" for p, c in zip(parents, children, strict=True)]
            fields = list(_of_transforms(each, store, static))
        elif _NAME in store.fielddefs[element][1] and 0 < len(set(each.name)) <= MOST_ELEMENTS:
            texts = [f"{name}.{own}" for own in each.name]
            fields = list(_fields(each, store, element))
        else:
            continue
        labels = np.array([_in_name(text) for text in texts])
        for label in np.unique(labels)[: most // len(fields) if fields else 0].tolist():
            alike = np.flatnonzero(labels == label)
            yield _together(
                [(f"{label}.{own}", unit, values[alike]) for own, unit, values in fields],
                each.owners[alike],
            )
        if element == _STATUS:
            yield from itertools.islice(_of_pairs(each.values, labels, each.owners), most)


def _of_pairs(pairs: Columns, labels: Any, rows: NDArray[np.int64]) -> Iterator[Numbers]:
    """Yield the numbers that diagnostics write as texts, by the names of their parts and keys."""
    found: dict[str, list[tuple[int, float]]] = defaultdict(list)
    for part, key, text in zip(pairs.owners.tolist(), pairs.key, pairs.value, strict=True):
        if number := _WRITTEN.fullmatch(str(text).strip()):
            found[f"{labels[part]}.{_in_name(key)}"].append((rows[part], float(number[1])))
    for name in sorted(found):
        at, values = zip(*found[name], strict=True)
        yield Numbers((name,), ("",), np.array(at), np.array(values)[:, np.newaxis])


def _of_transforms(each: Columns, store: Typestore, static: bool) -> Iterator[_Field]:
    place, rotation = each.transform.translation, each.transform.rotation
    yield "rotation.norm", "1", _unit(rotation)[1]
    if not static:
        yield from _fields(place, store, "geometry_msgs/msg/Vector3", "translation", "m")
        yield from _axes(rotation, "rotation")
