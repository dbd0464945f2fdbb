"""The windows of a recording: spans of time, each with a row of features.

A window is as long as an interval, so every second window coincides with a graph.
"""

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S

WINDOW_S = INTERVAL_S  # length of a window; the end of the recording may cut the last one off [s]
HOP_S = WINDOW_S / 2  # from the start of one window to that of the next [s]
MIN_WINDOW_S = MIN_INTERVAL_S  # a shorter rest at the end of a recording has no window [s]

_SECOND_NS = 1_000_000_000


def windows_ns(duration_ns: int, times_ns: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return start and end of each window that has a message, since the start [ns].

    Parameters
    ----------
    duration_ns : int
        Of the recording.
    times_ns : array of int, shape (n,)
        Arrival times of messages, since the start.

    Examples
    --------
    >>> times_ns = np.arange(0, 19, dtype=np.int64) * 10**9
    >>> [(start // 10**9, end // 10**9) for start, end in windows_ns(19 * 10**9, times_ns)]
    [(0, 10), (5, 15), (10, 19)]
    """
    length_ns, hop_ns, shortest_ns = (
        round(seconds * _SECOND_NS) for seconds in (WINDOW_S, HOP_S, MIN_WINDOW_S)
    )
    newest = times_ns // hop_ns  # window that a message is in
    back = np.arange(length_ns // hop_ns)  # those before it reach so far too
    numbers = np.unique((np.unique(newest)[:, np.newaxis] - back).ravel())
    starts = numbers[numbers >= 0] * hop_ns
    return [
        (start_ns, min(start_ns + length_ns, duration_ns))
        for start_ns in starts[starts < duration_ns - shortest_ns].tolist()
    ]
