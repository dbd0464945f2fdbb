"""Simulated time, and the order of events in it.

Callbacks that are due at the same time run in the order in which they were scheduled. So a
run depends on its inputs only.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Callback = Callable[..., None]

SECOND = 1_000_000_000
MILLISECOND = 1_000_000


@dataclass(slots=True, eq=False)
class Timer:
    """A callback at a fixed period of simulated time, until it is cancelled."""

    period_ns: int
    callback: Callable[[], None]
    active: bool = True

    def cancel(self) -> None:
        """Stop permanently."""
        self.active = False


class Executor:
    """A clock and a queue of callbacks.

    Parameters
    ----------
    on_advance
        Called with the new time [ns] whenever the clock moves, before any callback of that
        time: the physics advances here.
    """

    def __init__(self, on_advance: Callable[[int], None] = lambda _: None) -> None:
        self.now_ns = 0
        self._on_advance = on_advance
        # When, in which order, what and its arguments; a timer has none, and stays in the queue.
        self._queue: list[tuple[int, int, Any, tuple[Any, ...] | None]] = []
        self._scheduled = 0

    def call_at(self, time_ns: int, callback: Callback, *arguments: Any) -> None:
        """Run ``callback(*arguments)`` at ``time_ns``, which must not lie in the past."""
        if time_ns < self.now_ns:
            raise ValueError(f"cannot schedule at {time_ns} ns, it is {self.now_ns} ns already")
        heapq.heappush(self._queue, (time_ns, self._scheduled, callback, arguments))
        self._scheduled += 1

    def call_every(self, period_ns: int, callback: Callable[[], None], first_ns: int) -> Timer:
        """Run ``callback()`` every ``period_ns``, first at ``first_ns``."""
        timer = Timer(period_ns, callback)
        self.call_at(first_ns, self._start, timer)
        return timer

    def accompany(self, on_advance: Callable[[int], None]) -> None:
        """Also call this function whenever the clock moves; it must not change what runs."""
        first = self._on_advance

        def both(now_ns: int) -> None:
            first(now_ns)
            on_advance(now_ns)

        self._on_advance = both

    def run_until(self, time_ns: int, stop: Callable[[], bool] | None = None) -> None:
        """Run all callbacks that are due up to and including ``time_ns``.

        Returns early, with the clock where it is, once ``stop()`` holds after a callback.
        """
        queue, pop, replace = self._queue, heapq.heappop, heapq.heapreplace
        while queue and queue[0][0] <= time_ns:
            due_ns, _, callback, arguments = queue[0]
            if due_ns > self.now_ns:
                self.now_ns = due_ns
                self._on_advance(due_ns)
            if arguments is not None:
                pop(queue)
                callback(*arguments)
            elif callback.active:
                replace(queue, (due_ns + callback.period_ns, self._scheduled, callback, None))
                self._scheduled += 1
                callback.callback()
            else:
                pop(queue)
            if stop is not None and stop():
                return
        self._advance(time_ns)

    def _start(self, timer: Timer) -> None:
        if timer.active:
            entry = (self.now_ns + timer.period_ns, self._scheduled, timer, None)
            heapq.heappush(self._queue, entry)
            self._scheduled += 1
            timer.callback()

    def _advance(self, time_ns: int) -> None:
        self.now_ns = time_ns
        self._on_advance(time_ns)
