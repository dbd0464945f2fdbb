"""What one request keeps of the messages of one topic, as an array."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.limits import MOST_KEPT
from oracle_pipeline.features.plugin import Request, Series

Integers: TypeAlias = NDArray[np.int64]

_BROKEN_SHARE = 0.1  # of the messages of a topic; if more are broken, it is the type that is wrong


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of a recording: from a nanosecond after its start to the one before another."""

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
        """Return which of ascending times are in the span."""
        first, after = times_ns.searchsorted((self.start_ns, self.end_ns)).tolist()
        return slice(first, after)


class Budget:
    """What may be kept of all messages together."""

    def __init__(self) -> None:
        self._left = MOST_KEPT

    def take(self, size: int) -> bool:
        """Tell whether there is still room, and take it."""
        self._left -= size
        return self._left >= 0


class KeptRows:
    """What one request keeps of one topic."""

    def __init__(self, request: Request, budget: Budget) -> None:
        self.request = request
        self.as_scan = False  # of a point cloud, what a planar scanner would have seen
        self.error = ""  # why there is nothing to be had from this topic
        self._budget = budget
        self._numbers: list[int] = []  # of the messages, in the whole recording
        self._rows: list[Any] = []
        self._broken = 0
        self._first_error = ""

    def add(self, number: int, content: Any, size: int) -> None:
        """Keep what is wanted of a message."""
        if self.error:
            return
        try:
            row = self.request.keep(content)
        except Exception as error:  # foreign code
            self.skip(f"{type(error).__name__}: {error}")
            return
        if row is None:
            return
        if not self._budget.take(_size(row, size)):
            self.fail(
                f"features keep more than {MOST_KEPT} bytes of this recording, the limit "
                "(MOST_KEPT); cut it into shorter ones"
            )
            return
        self._rows.append(row)
        self._numbers.append(number)

    def skip(self, error: str) -> None:
        """Leave a broken message out."""
        self._broken += 1
        self._first_error = self._first_error or error

    def fail(self, error: str) -> None:
        """Give the topic up."""
        self.error = error
        self._rows.clear()
        self._numbers.clear()

    def finish(self, times_ns: Integers) -> str | None:
        """Make arrays of all that was kept, in time order; return what was left out, if it was."""
        tried = self._broken + len(self._rows)
        if not self.error and self._broken > _BROKEN_SHARE * tried:
            self.fail(f"{self._broken} of {tried} messages are broken: {self._first_error}")
        try:
            values: NDArray[Any] = (
                np.fromiter(self._rows, dtype=object, count=len(self._rows))
                if np.dtype(self.request.dtype) == object
                else np.array(self._rows, dtype=self.request.dtype)
            )
        except (ValueError, TypeError, OverflowError) as error:
            self.error = f"what is kept of each message must have the same shape: {error}"
            return None
        self._rows.clear()
        kept_ns = times_ns[np.array(self._numbers, dtype=np.int64)]
        order = np.argsort(kept_ns, kind="stable")
        self._times_ns = kept_ns[order]
        self._series = Series(read_only(self._times_ns / 1e9), read_only(values[order]))
        if self.error or not self._broken:
            return None
        return f"{self._broken} of {tried} messages are left out as broken: {self._first_error}"

    def within(self, span: Span) -> Series:
        """Return what came in a span."""
        part = span.of(self._times_ns)
        return Series(self._series.times_s[part], self._series.values[part])


def _size(row: Any, size: int) -> int:
    """Return about how many bytes a row takes; one that is no array, as many as its message."""
    return int(row.nbytes) if isinstance(row, np.ndarray) else size


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array that can no longer be written to."""
    values.flags.writeable = False
    return values
