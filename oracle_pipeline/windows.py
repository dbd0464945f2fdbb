"""The windows of a recording: spans of time, each with a row of features.

Windows are short, so that alarms come early. A window is shorter than the interval between graphs,
so it uses the newest graph that was complete when it ended.
"""

import numpy as np
from numpy.typing import NDArray

WINDOW_S = 5.0  # length of a window; the last one may be shorter [s]
HOP_S = WINDOW_S / 2  # between the starts of two windows [s]
MIN_WINDOW_S = HOP_S  # shortest last window [s]
SHORTEST_S = 0.25  # of a recording; up to `MIN_WINDOW_S` it is one window [s]

_SECOND_NS = 1_000_000_000


def windows_ns(duration_ns: int, times_ns: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return start and end of each window that has a message, since the start [ns].

    A recording from `SHORTEST_S` to `MIN_WINDOW_S` is one window.

    Parameters
    ----------
    duration_ns : int
        Of the recording.
    times_ns : array of int, shape (n,)
        Arrival times of messages, since the start.

    Examples
    --------
    >>> times_ns = np.arange(0, 12, dtype=np.int64) * 10**9
    >>> [(start / 1e9, end / 1e9) for start, end in windows_ns(12 * 10**9, times_ns)]
    [(0.0, 5.0), (2.5, 7.5), (5.0, 10.0), (7.5, 12.0)]
    """
    length_ns, hop_ns, shortest_ns = (
        round(seconds * _SECOND_NS) for seconds in (WINDOW_S, HOP_S, MIN_WINDOW_S)
    )
    if round(SHORTEST_S * _SECOND_NS) <= duration_ns <= shortest_ns and len(times_ns):
        return [(0, duration_ns)]
    newest = times_ns // hop_ns  # last window with each message
    back = np.arange(length_ns // hop_ns)  # earlier overlapping windows have it too
    numbers = np.unique((np.unique(newest)[:, np.newaxis] - back).ravel())
    starts = numbers[numbers >= 0] * hop_ns
    return [
        (start_ns, min(start_ns + length_ns, duration_ns))
        for start_ns in starts[starts < duration_ns - shortest_ns].tolist()
    ]
