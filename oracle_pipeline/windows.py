"""The windows of a recording: the spans of time that have a row of features each.

A window is as long as an interval, so that every other window has a graph to itself.
"""

from collections.abc import Iterator

from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S

WINDOW_S = INTERVAL_S  # length of a window; the end of the recording may cut the last one off [s]
HOP_S = WINDOW_S / 2  # from the start of one window to that of the next [s]
MIN_WINDOW_S = MIN_INTERVAL_S  # a shorter rest at the end of a recording has no window [s]

_SECOND_NS = 1_000_000_000


def windows_ns(duration_ns: int) -> Iterator[tuple[int, int]]:
    """Yield start and end of each window of a recording, since its start [ns].

    Examples
    --------
    >>> [(start // 10**9, end // 10**9) for start, end in windows_ns(19 * 10**9)]
    [(0, 10), (5, 15), (10, 19)]
    """
    length_ns, hop_ns, shortest_ns = (
        round(seconds * _SECOND_NS) for seconds in (WINDOW_S, HOP_S, MIN_WINDOW_S)
    )
    for start_ns in range(0, duration_ns - shortest_ns, hop_ns):
        yield start_ns, min(start_ns + length_ns, duration_ns)
