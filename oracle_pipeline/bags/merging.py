"""Merges messages in order of time from parts of files that overlap in time.

Recorders write slightly out of order: several threads, one chunk for each topic, no chunks at all.
A first pass notes when each stretch begins; in the second, a message waits until no later stretch
can have an older one.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.limits import LARGEST_DISORDER

Rows: TypeAlias = NDArray[np.int64]

_NEVER = np.iinfo(np.int64).max


class Messages(NamedTuple):
    """Messages of a stretch of a file, in file order; one row per message."""

    data: bytes
    topics: NDArray[np.int64]  # number of the topic, in the order of ``BagReader.topics``
    stamps_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]  # of the message in ``data``
    sizes: NDArray[np.int64]  # [B]

    def message(self, row: int) -> bytes:
        """Return a message's bytes."""
        offset = int(self.offsets[row])
        return self.data[offset : offset + int(self.sizes[row])]

    def messages(self, rows: Rows) -> list[bytes]:
        """Return the bytes of some messages."""
        begins = self.offsets[rows]
        ends = begins + self.sizes[rows]
        return [self.data[a:b] for a, b in zip(begins.tolist(), ends.tolist(), strict=True)]

    def by_topic(self) -> Iterator[tuple[int, Rows]]:
        """Yield the number of each topic in the batch with its rows, in file order."""
        order = np.argsort(self.topics, kind="stable")
        numbers, begins = np.unique(self.topics[order], return_index=True)
        yield from zip(numbers.tolist(), np.split(order, begins[1:]), strict=False)


def in_time_order(
    read: Callable[[], Iterator[Messages]], *, is_in_order: bool
) -> Iterator[tuple[Messages, Rows]]:
    """Yield batches and the rows of them that are due, in order of time.

    Parameters
    ----------
    read : callable
        Reads the messages from the beginning, the same each time.
    is_in_order : bool
        No batch begins before the end of the previous one, so one pass is enough.

    Notes
    -----
    The messages held are bounded (``LARGEST_DISORDER``). Messages that are further out of order
    than this are yielded late.
    """
    if is_in_order:
        for batch in read():
            yield batch, np.argsort(batch.stamps_ns, kind="stable")
        return
    begins = [int(batch.stamps_ns.min(initial=_NEVER)) for batch in read()]
    after = np.array([*begins[1:], _NEVER][: len(begins)], dtype=np.int64)
    following = np.minimum.accumulate(after[::-1])[::-1]
    waiting: list[tuple[Messages, Rows]] = []
    for batch, after_ns in zip(read(), following.tolist(), strict=True):
        if len(batch.stamps_ns):
            waiting.append((batch, np.argsort(batch.stamps_ns, kind="stable")))
        held = sum(len(each.data) for each, _ in waiting)
        due_ns = after_ns if held <= LARGEST_DISORDER else _NEVER
        waiting, due = _split(waiting, due_ns)
        yield from _merged(due)


def _split(
    waiting: list[tuple[Messages, Rows]], due_ns: int
) -> tuple[list[tuple[Messages, Rows]], list[tuple[Messages, Rows]]]:
    """Separate the rows that must wait from those that no later message can precede."""
    still, due = [], []
    for batch, rows in waiting:
        place = int(np.searchsorted(batch.stamps_ns[rows], due_ns, side="right"))
        if place:
            due.append((batch, rows[:place]))
        if place < len(rows):
            still.append((batch, rows[place:]))
    return still, due


def _merged(due: list[tuple[Messages, Rows]]) -> Iterator[tuple[Messages, Rows]]:
    """Yield rows of several batches in order of time: equal stamps in file order."""
    if len(due) == 1:
        yield due[0]
    if len(due) < 2:
        return
    stamps_ns = np.concatenate([batch.stamps_ns[rows] for batch, rows in due])
    owners = np.repeat(np.arange(len(due)), [len(rows) for _, rows in due])
    places = np.concatenate([rows for _, rows in due])
    order = np.argsort(stamps_ns, kind="stable")
    owners, places = owners[order], places[order]
    for run in np.split(np.arange(len(owners)), np.flatnonzero(np.diff(owners)) + 1):
        yield due[owners[run[0]]][0], places[run]
