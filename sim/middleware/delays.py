"""Arrival times of messages at a node's callbacks on a computer with other load."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sim.middleware.executor import MILLISECOND

TIME_SLICE_MS = 10.0  # at most, until a preempted process runs again
_AT_ONCE = 256  # draws


@dataclass(frozen=True, slots=True)
class Load:
    """Distribution of the delays of deliveries."""

    jitter_ms: float = 0.0  # mean of the transport's exponentially distributed delay
    processor: float = 0.0  # share of the time in which another process has the processor


class Delays:
    """Arrival times at one node: its callbacks run one after another, in the order of arrival.

    Every delivery takes the node's latency and the transport's jitter. With the probability that
    the processor is taken, it also waits for the rest of a time slice, evenly distributed.

    Parameters
    ----------
    load
        How the delays are distributed.
    rng
        Draws them.
    """

    def __init__(self, load: Load, rng: np.random.Generator) -> None:
        self._draws = _draws(load, rng)
        self._last_ns = 0

    def due_ns(self, sent_ns: int, latency_ns: int) -> int:
        """Return when a message that is sent now arrives [ns]."""
        self._last_ns = max(self._last_ns, sent_ns + latency_ns + next(self._draws))
        return self._last_ns


def _draws(load: Load, rng: np.random.Generator) -> Iterator[int]:
    while True:
        later_ms = load.jitter_ms * rng.standard_exponential(_AT_ONCE)
        taken, share = rng.random((2, _AT_ONCE))
        later_ms += np.where(taken < load.processor, TIME_SLICE_MS * share, 0.0)
        yield from np.rint(MILLISECOND * later_ms).astype(np.int64).tolist()
