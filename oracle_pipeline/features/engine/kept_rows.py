"""The rows that one request keeps of the messages of one topic, as an array."""

from array import array
from collections.abc import Mapping
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import MOST_KEPT
from oracle_pipeline.features.engine import memory
from oracle_pipeline.features.engine.columns import ColumnSource
from oracle_pipeline.features.engine.plugin import Request, Series
from oracle_pipeline.features.engine.spans import Integers, Span

_CARRIED = 20  # last rows of a request that later windows can use
_BROKEN_SHARE = 0.1  # of the messages of a topic; if more are broken, its type is wrong


class _TimedRows(NamedTuple):
    """The rows kept of one topic, sorted by time."""

    times_ns: Integers  # since the start of the recording, shape (n,)
    values: NDArray[Any]  # shape (n, ...)

    def followed_by(self, later: Self) -> "_TimedRows":
        """Return these rows, without any after the first of the later ones, and then those."""
        if not len(later.times_ns):
            return self
        older = slice(0, int(self.times_ns.searchsorted(later.times_ns[0])))
        return (
            _TimedRows(
                np.concatenate([self.times_ns[older], later.times_ns]),
                np.concatenate([self.values[older], later.values]),
            )
            if older.stop
            else _TimedRows(*later)
        )


#: Rows for later windows, by topic and key of the request.
Carried: TypeAlias = Mapping[tuple[str, Any], _TimedRows]


class KeptRows:
    """The rows that one request keeps of one topic."""

    def __init__(self, request: Request, budget: memory.MemoryBudget) -> None:
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
        if row is not None and self._fits(memory.size_of_row(row, size)):
            self._rows.append(row)
            self._numbers.append(number)

    def add_many(self, numbers: Integers, messages: ColumnSource) -> None:
        """Keep the requested part of messages, all of which are whole."""
        if self.error or not len(numbers):
            return
        try:
            kept = self.request.keep(messages.columns())
            rows = self._rows_of(kept, len(numbers))
        except Exception as error:  # foreign code
            if len(numbers) == 1:
                known = isinstance(error, BagError)
                self.skip(str(error) if known else f"{type(error).__name__}: {error}")
                return
            for row in range(len(numbers)):
                self.add_many(numbers[row : row + 1], messages.some(np.array([row])))
            return
        is_array = isinstance(rows, np.ndarray)
        if self._fits(
            memory.size_of_array(rows) if is_array else memory.size_of_rows(kept, messages.data)
        ):
            if is_array:
                self._blocks.append(rows)
            else:
                numbers = numbers[[row is not None for row in rows]]
                self._rows += [row for row in rows if row is not None]
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

    def _fits(self, size: int) -> bool:
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

    def close(self, times_ns: Integers, earlier: _TimedRows | None) -> str | None:
        """Convert the rows to arrays sorted by time; return a note on messages left out, if any.

        Parameters
        ----------
        times_ns : ndarray of shape (n_messages,)
            Of all messages, since the start of the recording.
        earlier : TimedRows or None
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
        rows = _TimedRows(kept_ns, values)
        if earlier is not None:
            rows = earlier.followed_by(rows)
        self._times_ns = rows.times_ns
        self._series = Series(_read_only(rows.times_ns / 1e9), _read_only(rows.values))
        self._last: tuple[Span | None, Series] = None, self._series  # result of `within`
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

    def last(self) -> _TimedRows:
        """Return the last rows."""
        return _TimedRows(self._times_ns[-_CARRIED:], self._series.values[-_CARRIED:])

    def within(self, span: Span) -> Series:
        """Return the rows in a span, the same object to each plugin that asks in turn."""
        last_span, series = self._last
        if last_span is not span:
            part = span.slice_of(self._times_ns)
            if part == slice(0, len(self._times_ns)):
                series = self._series
            else:
                series = Series(self._series.times_s[part], self._series.values[part])
            self._last = span, series
        return series


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array that can no longer be written to."""
    values.flags.writeable = False
    return values
