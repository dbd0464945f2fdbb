"""Finds the fields of a topic's messages that never change within a recording, or are few texts.

Examples are the frame, angles and limits of a scanner, the names of joints, the corners of a safety
zone, the mount of a sensor in the static transforms, or the states that a task reports. Few
features would notice a change in such a field, and it needs no statistics to report one.
"""

import itertools
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.merging import Messages, Rows
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import typestore
from oracle_pipeline.features.engine.columns import Columns, SerializedMessages
from oracle_pipeline.features.engine.common_fields import frame_names
from oracle_pipeline.robots.first_messages import TRANSFORM_TYPES
from oracle_pipeline.robots.roles import is_static
from oracle_pipeline.scoring.pace import FEWEST
from oracle_pipeline.scoring.parameters import EVENTS, ReportedParameters, parameters_of

MOST_MESSAGES = 50  # sampled per topic, spread over the recording
MOST_OF_TRANSFORMS = 1000  # per topic of transforms, whose messages have different frames
MOST_BYTES = 4_000_000  # sampled per topic
MOST_ELEMENTS = 64  # of a sequence; longer ones are measurements
_DECIMALS = 6  # of a transform
_TO = " -> "  # from parent to child
_TIME = "builtin_interfaces/msg/Time"
LIKE, OR = "like ", " or "  # begins and joins the texts of a field that changes between few
_MOST_TEXTS = 8  # of such a field
_NUMBER = re.compile(r"\d+(\.\d+)?")


class Samples:
    """Messages of each topic of a bag, spread evenly, taken while the bag is read.

    Topics with fewer than `FEWEST` messages are left out, except for transforms, texts and events
    of parameters. Of static transforms, texts and events, all messages are taken.
    """

    def __init__(self, bag: BagReader) -> None:
        self._bag = bag
        topics = bag.topics
        self._transforms = {n for n, topic in topics.items() if topic.msgtype in TRANSFORM_TYPES}
        self._events = [name for name, topic in topics.items() if topic.msgtype == EVENTS]
        most = dict.fromkeys(self._transforms, MOST_OF_TRANSFORMS)
        texts = (name for name, topic in topics.items() if topic.msgtype == "std_msgs/msg/String")
        static = (name for name in self._transforms if is_static(topics[name]))
        whole = (*self._events, *texts, *static)
        most |= {name: max(1, topics[name].count) for name in whole}
        self._taken: dict[str, list[bytes]] = {
            name: [] for name, topic in topics.items() if topic.count >= FEWEST or name in most
        }
        self._names = list(topics)
        self._every = [-(-each.count // most.get(n, MOST_MESSAGES)) for n, each in topics.items()]
        self._passed = np.zeros(len(topics), dtype=np.int64)
        self._left = np.full(len(topics), MOST_BYTES, dtype=np.int64)

    def add(self, batch: Messages, number: int, rows: Rows) -> None:
        """Sample the next messages of a topic: some rows of a batch."""
        taken = self._taken.get(self._names[number])
        if taken is None:
            return
        every = self._every[number]
        for row in rows[-self._passed[number] % every :: every].tolist():
            if self._left[number] > 0:
                taken.append(batch.message(row))
                self._left[number] -= batch.sizes[row]
        self._passed[number] += len(rows)

    def constants(self) -> dict[str, dict[str, str]]:
        """Return the fields that are equal in all sampled messages, by topic, and their values.

        Stamps do not count, nor do sequences whose length varies or exceeds `MOST_ELEMENTS`. A text
        that changes between few counts, without its numbers: ``like 'goal #' or 'idle'``. A
        transform counts as two fields, named after its frames: a joint turns, and its link is
        mounted in one place. Topics of an unknown type are left out.
        """
        found: dict[str, dict[str, str]] = {}
        for topic, data in self._taken.items():
            kind = self._bag.topics[topic]
            try:
                store = self._bag.typestore(kind.msgtype)
            except BagError:
                continue
            batch = SerializedMessages(data, store, kind.msgtype, is_cdr=kind.encoding != "ros1")
            if not batch.whole.all():
                continue
            found[topic] = {}
            if len(data) >= 2 and not is_static(kind) and kind.msgtype != "rcl_interfaces/msg/Log":
                found[topic] |= _equal(batch.columns(), store, kind.msgtype)
            if topic in self._transforms:
                found[topic] |= _transforms(batch.columns())
        return found

    def entropies(self) -> dict[str, float]:
        """Return the entropy of the bytes of each topic's messages [bit].

        It changes with what a topic carries, whatever its type: a grid whose cells have other
        values, an array of another resolution, a text that is longer.
        """
        sampled = {topic: b"".join(data) for topic, data in self._taken.items() if any(data)}
        return {topic: _entropy(data) for topic, data in sampled.items()}

    def parameters(self) -> ReportedParameters:
        """Return the parameters that were reported."""
        reported = [data for topic in self._events for data in self._taken[topic]]
        whole = SerializedMessages(reported, typestore(), EVENTS, is_cdr=True).whole
        return parameters_of(itertools.compress(reported, whole))


def is_of_transform(path: str) -> bool:
    """Return whether a field is the translation or rotation of a transform."""
    return _TO in path


def _transforms(messages: Columns) -> Iterator[tuple[str, str]]:
    """Yield translation and rotation of the transforms that are always published with one value."""
    each = messages.transforms
    shift, q = each.transform.translation, each.transform.rotation
    parents, children = frame_names(each.header.frame_id), frame_names(each.child_frame_id)
    rows: dict[str, list[NDArray[np.float64]]] = {}
    numbers = np.column_stack([shift.x, shift.y, shift.z, q.x, q.y, q.z, q.w])
    for parent, child, row in zip(parents, children, numbers.round(_DECIMALS) + 0.0, strict=True):
        rows.setdefault(f"{parent}{_TO}{child}", []).append(row)
    for frames, published in rows.items():
        values = np.array(published)
        yield from _constant(f"{frames} translation", values[:, :3])
        yield from _constant(f"{frames} rotation", values[:, 3:])


def _equal(
    messages: Columns, store: Typestore, msgtype: str, path: str = "", shape: tuple[int, ...] = ()
) -> Iterator[tuple[str, str]]:
    """Yield the fields of a type that are equal in all messages, and their values.

    If the messages are elements of a sequence, its length is the shape.
    """
    for name, (kind, what) in store.fielddefs[msgtype][1]:
        if kind == Nodetype.NAME:
            if what != _TIME:
                nested = getattr(messages, name)
                yield from _equal(nested, store, str(what), f"{path}{name}.", shape)
        elif kind == Nodetype.BASE or (kind == Nodetype.ARRAY and what[0][0] == Nodetype.BASE):
            values = np.asarray(getattr(messages, name))
            yield from _constant(path + name, values.reshape(-1, *shape, *values.shape[1:]))
        elif shape:  # sequences of sequences are measurements
            continue
        elif what[0][0] == Nodetype.BASE:
            sequences = getattr(messages, name)
            if _common_length([len(each) for each in sequences]):
                yield from _constant(path + name, np.array([[*each] for each in sequences], object))
        elif what[0][1] != _TIME:
            elements = getattr(messages, name)
            length = _common_length(np.bincount(elements.owners, minlength=len(messages)))
            if length:
                element = str(what[0][1])
                yield from _equal(elements, store, element, f"{path}{name}.", (length,))


def _common_length(lengths: ArrayLike) -> int:
    """Return the length of all sequences; 0 if it varies or is too large."""
    shortest, longest = np.min(lengths), np.max(lengths)
    return int(longest) if shortest == longest <= MOST_ELEMENTS else 0


def _constant(path: str, values: NDArray[Any]) -> Iterator[tuple[str, str]]:
    """Yield a field and its value if it is equal in all messages, shape (n_messages, ...).

    Of a text that changes between few, these are the value.
    """
    first, is_nan = values[0], values != values
    if ((values == first) | (is_nan & is_nan[0])).all():
        yield path, _text(first)
    elif isinstance(first, str):
        few = likes(OR.join(map(_text, set(values.tolist()))))
        if len(few) <= _MOST_TEXTS:
            yield path, LIKE + OR.join(sorted(few))


def likes(value: str) -> set[str]:
    """Return the texts that a field is like, without their numbers.

    Examples
    --------
    >>> sorted(likes("like 'goal 7' or 'idle'"))
    ["'goal #'", "'idle'"]
    """
    return set(_NUMBER.sub("#", value.removeprefix(LIKE)).split(OR))


def _entropy(data: bytes) -> float:
    counts = np.bincount(np.frombuffer(data, np.uint8))
    shares = counts[counts > 0] / len(data)
    return float(-shares @ np.log2(shares))


def _text(value: Any) -> str:
    """Return a string, a number or an array of them as text."""
    if isinstance(value, str):
        return repr(value)
    if np.ndim(value):
        return f"[{', '.join(_text(each) for each in value)}]"
    return f"{value:.9g}"
