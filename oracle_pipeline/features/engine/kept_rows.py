"""The rows that one request keeps of the messages of one topic, as an array."""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import MOST_KEPT
from oracle_pipeline.features.engine.between import between
from oracle_pipeline.features.engine.columns import Messages
from oracle_pipeline.features.engine.plugin import Request, Series

Integers: TypeAlias = NDArray[np.int64]

CARRIED = 20  # last rows of a request that later windows can use
_MESSAGE_BYTES = 40
_OBJECT_BYTES = 64  # of a small Python object, and of an array without its numbers
_SAMPLE = 16  # rows of a batch whose sizes are measured
# As tuples, since a union would be made anew for each message.
_CONTAINERS = np.ndarray, tuple, list
_MEASURED = np.ndarray, tuple, float  # kept objects of known size
_BROKEN_SHARE = 0.1  # of the messages of a topic; if more are broken, its type is wrong


@dataclass(frozen=True, slots=True)
class Span:
    """A half-open interval of a recording, in nanoseconds since its start."""

    start_ns: int
    end_ns: int

    @property
    def start_s(self) -> float:
        """Start [s]."""
        return self.start_ns / 1e9

    @property
    def end_s(self) -> float:
        """End [s]."""
        return self.end_ns / 1e9

    def of(self, times_ns: Integers) -> slice:
        """Return the slice of ascending times that is in the span."""
        return slice(*between(times_ns, self.start_ns, self.end_ns))


class Budget:
    """The memory that the rows of all topics together may take."""

    def __init__(self) -> None:
        self._left = MOST_KEPT

    def count(self, messages: int) -> None:
        """Subtract what is kept of every message: its time, size and stamp."""
        self._left -= messages * _MESSAGE_BYTES

    def take(self, size: int) -> bool:
        """Subtract a size; return False if the budget is exceeded."""
        self._left -= size
        return self._left >= 0


class Rows(NamedTuple):
    """The rows kept of one topic, sorted by time."""

    times_ns: Integers  # since the start of the recording, shape (n,)
    values: NDArray[Any]  # shape (n, ...)

    def followed_by(self, later: Self) -> "Rows":
        """Return these rows, without any after the first of the later ones, and then those."""
        if not len(later.times_ns):
            return self
        older = slice(0, int(self.times_ns.searchsorted(later.times_ns[0])))
        return (
            Rows(
                np.concatenate([self.times_ns[older], later.times_ns]),
                np.concatenate([self.values[older], later.values]),
            )
            if older.stop
            else Rows(*later)
        )


#: Rows for later windows, by topic and key of the request.
Carried: TypeAlias = Mapping[tuple[str, Any], Rows]


class KeptRows:
    """The rows that one request keeps of one topic."""

    def __init__(self, request: Request, budget: Budget) -> None:
        self.request = request
        self.as_scan = False  # a point cloud is converted to a planar scan
        self.error = ""  # why this topic cannot be used
        self._budget = budget
        self._numbers = array("q")  # of the messages, in the whole recording
        self._rows: list[Any] = []
        self._blocks: list[NDArray[Any]] = []  # the same of many messages, unless they are objects
        self._broken = 0
        self._first_error = ""

    def add(self, number: int, content: Any, size: int) -> None:
        """Keep the requested part of a message."""
        if self.error:
            return
        try:
            row = self.request.keep(content)
        except Exception as error:  # foreign code
            self.skip(f"{type(error).__name__}: {error}")
            return
        # The size of other objects is unknown.
        is_object = not isinstance(row, _MEASURED)
        if row is not None and self._has_room(max(_size(row), size if is_object else 0)):
            self._rows.append(row)
            self._numbers.append(number)

    def add_many(self, numbers: Integers, batch: Messages) -> None:
        """Keep the requested part of messages, all of which are whole."""
        if self.error or not len(numbers):
            return
        try:
            kept = self.request.keep(batch.columns())
            rows = self._rows_of(kept, len(numbers))
        except Exception as error:  # foreign code
            if len(numbers) == 1:
                known = isinstance(error, BagError)
                self.skip(str(error) if known else f"{type(error).__name__}: {error}")
                return
            for row in range(len(numbers)):
                self.add_many(numbers[row : row + 1], batch.some(np.array([row])))
            return
        is_array = isinstance(rows, np.ndarray)
        if self._has_room(_size_of_array(rows) if is_array else _size_of_many(kept, batch)):
            if is_array:
                self._blocks.append(rows)
            else:
                self._rows += rows
            self._numbers.extend(numbers)

    def _rows_of(self, kept: Any, count: int) -> Any:
        """Return the kept part of many messages as an array of rows; objects as a list."""
        if np.dtype(self.request.dtype) != object:
            kept = np.column_stack(kept) if isinstance(kept, tuple) else np.asarray(kept)
            kept = kept.astype(self.request.dtype, copy=False)
        elif isinstance(kept, tuple):
            columns = [each.tolist() if isinstance(each, np.ndarray) else each for each in kept]
            kept = list(zip(*columns, strict=True))
        if len(kept) != count:
            raise ValueError(f"{len(kept)} rows were kept of {count} messages")
        return kept

    def _has_room(self, size: int) -> bool:
        if not self._budget.take(size):
            self.fail(
                f"features keep more than {MOST_KEPT} bytes of this recording, the limit "
                "(MOST_KEPT); cut it into shorter ones"
            )
        return not self.error

    def skip(self, error: str) -> None:
        """Leave a broken message out."""
        self._broken += 1
        self._first_error = self._first_error or error

    def fail(self, error: str) -> None:
        """Discard the topic's rows."""
        self.error = error
        self._rows.clear()
        self._blocks.clear()
        del self._numbers[:]

    def finish(self, times_ns: Integers, earlier: Rows | None) -> str | None:
        """Convert the rows to arrays sorted by time; return a note on messages left out, if any.

        Parameters
        ----------
        times_ns : ndarray of shape (n_messages,)
            Of all messages, since the start of the recording.
        earlier : Rows or None
            Kept of messages that have been dropped.
        """
        tried = self._broken + len(self._numbers)
        if not self.error and self._broken > _BROKEN_SHARE * tried:
            self.fail(f"{self._broken} of {tried} messages are broken: {self._first_error}")
        try:
            values = self._values()
        except (ValueError, TypeError, OverflowError) as error:
            self.error = f"what is kept of each message must have the same shape: {error}"
            return f"what needs it is missing: {self.error}"
        self._rows.clear()
        self._blocks.clear()
        kept_ns = times_ns[np.frombuffer(self._numbers, dtype=np.int64)]
        if (np.diff(kept_ns) < 0).any():
            order = np.argsort(kept_ns, kind="stable")
            kept_ns, values = kept_ns[order], values[order]
        rows = Rows(kept_ns, values)
        if earlier is not None:
            rows = earlier.followed_by(rows)
        self._times_ns = rows.times_ns
        self._series = Series(read_only(rows.times_ns / 1e9), read_only(rows.values))
        self._cut: tuple[Span | None, Series] = None, self._series  # the last result of `within`
        if self.error:
            return f"what needs it is missing: {self.error}"
        if not self._broken:
            return None
        return f"{self._broken} of {tried} messages are left out as broken: {self._first_error}"

    def _values(self) -> NDArray[Any]:
        if self._blocks:
            return np.concatenate(self._blocks)
        if np.dtype(self.request.dtype) == object:
            return np.fromiter(self._rows, dtype=object, count=len(self._rows))
        return np.array(self._rows, dtype=self.request.dtype)

    def last(self) -> Rows:
        """Return the last rows."""
        return Rows(self._times_ns[-CARRIED:], self._series.values[-CARRIED:])

    def within(self, span: Span) -> Series:
        """Return the rows in a span, the same object to each plugin that asks in turn."""
        cut_to, series = self._cut
        if cut_to is not span:
            part = span.of(self._times_ns)
            if part == slice(0, len(self._times_ns)):
                series = self._series
            else:
                series = Series(self._series.times_s[part], self._series.values[part])
            self._cut = span, series
        return series


def _size(kept: Any) -> int:
    """Return the approximate size of an object in memory [B]."""
    if isinstance(kept, np.ndarray) and kept.dtype != object:
        return int(kept.nbytes) + _OBJECT_BYTES
    if isinstance(kept, _CONTAINERS):
        return _OBJECT_BYTES + sum(map(_size, kept))
    return _OBJECT_BYTES


def _size_of_array(rows: NDArray[Any]) -> int:
    return 2 * rows.nbytes  # concatenation needs a copy


def _size_of_many(kept: Any, batch: Messages) -> int:
    """Return the approximate size of rows [B], given as columns or one by one."""
    if isinstance(kept, tuple):
        return sum(_size_of_column(column) for column in kept)
    step = 1 + len(kept) // _SAMPLE
    return max(sum(map(len, batch.data)), step * sum(map(_size, kept[::step])))


def _size_of_column(column: Any) -> int:
    if isinstance(column, np.ndarray) and column.dtype != object:
        return len(column) * _OBJECT_BYTES
    distinct = {id(each): each for each in column}  # names of frames are shared
    return len(column) * _OBJECT_BYTES + sum(map(_size, distinct.values()))


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array that can no longer be written to."""
    values.flags.writeable = False
    return values
