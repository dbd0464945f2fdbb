"""Finds the fields of a topic's messages that never change within a recording.

Examples are the frame, angles and limits of a scanner, or the names of joints. Few features would
notice a change in such a field, and it needs no statistics to report one.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.features.columns import Batch, Columns
from oracle_pipeline.scoring.pace import FEWEST

MOST_MESSAGES = 50  # sampled per topic, spread over the recording
MOST_BYTES = 4_000_000  # sampled per topic
_TIME = "builtin_interfaces/msg/Time"


def constants(bag: BagReader) -> dict[str, dict[str, str]]:
    """Return the fields that are equal in all sampled messages, by topic, and their values.

    Numbers, strings and arrays of fixed length count; sequences and stamps do not. Topics with
    fewer than `FEWEST` messages, or of an unknown type, are left out.
    """
    found = {}
    for topic, data in _sampled(bag).items():
        kind = bag.topics[topic]
        try:
            store = bag.typestore(kind.msgtype)
        except BagError:
            continue
        batch = Batch(data, store, kind.msgtype, is_cdr=kind.encoding != "ros1")
        if len(data) >= 2 and batch.whole.all():
            found[topic] = dict(_equal(batch.columns(), store, kind.msgtype))
    return found


def _sampled(bag: BagReader) -> dict[str, list[bytes]]:
    """Return messages of each topic, spread evenly."""
    names = list(bag.topics)
    counts = np.array([bag.topics[name].count for name in names], dtype=np.int64)
    every = -(-counts // MOST_MESSAGES)
    taken: dict[str, list[bytes]] = {
        name: [] for name, topic in bag.topics.items() if topic.count >= FEWEST
    }
    passed = np.zeros(len(names), dtype=np.int64)
    left = np.full(len(names), MOST_BYTES, dtype=np.int64)
    for batch in bag.batches(taken):
        for number in np.unique(batch.topics).tolist():
            rows = np.flatnonzero(batch.topics == number)
            for row in rows[-passed[number] % every[number] :: every[number]].tolist():
                if left[number] > 0:
                    taken[names[number]].append(batch.message(row))
                    left[number] -= batch.sizes[row]
            passed[number] += len(rows)
    return taken


def _equal(
    messages: Columns, store: Typestore, msgtype: str, path: str = ""
) -> Iterator[tuple[str, str]]:
    """Yield the fields of a type that are equal in all messages, and their values."""
    for name, (kind, what) in store.fielddefs[msgtype][1]:
        if kind == Nodetype.NAME and what != _TIME:
            yield from _equal(getattr(messages, name), store, str(what), f"{path}{name}.")
        elif kind == Nodetype.BASE or (kind == Nodetype.ARRAY and what[0][0] == Nodetype.BASE):
            values = getattr(messages, name)
            first, is_nan = values[0], values != values
            if ((values == first) | (is_nan & is_nan[0])).all():
                yield path + name, _text(first)


def _text(value: Any) -> str:
    """Return a string, a number or an array of numbers as text."""
    if isinstance(value, str):
        return repr(value)
    if np.ndim(value):
        return f"[{', '.join(_text(each) for each in value)}]"
    return f"{value:.9g}"
