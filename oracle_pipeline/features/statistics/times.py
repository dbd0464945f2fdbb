"""Times at which sources are compared: even ones, and those nearest to others.

Stamps in headers are what a sensor's driver put there: 0 until it knew the time, or that of another
year. So pauses of stamps are left out where even times would be too many.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]

MOST_TIMES = 1_000_000
_LONGEST_PAUSE_S = 60.0  # without a stamp, of those that are left out


def even_times(begin_s: float, end_s: float, step_s: float, *stamps_s: Floats) -> Floats:
    """Return the times from the first up to the last; beyond `MOST_TIMES`, those near stamps.

    Parameters
    ----------
    begin_s, end_s : float
        The first time, and what all are below [s].
    step_s : float
        Between two times [s].
    *stamps_s : ndarray
        Of the messages, in any order [s].

    Raises
    ------
    BagError
        If those near stamps are too many as well.

    Examples
    --------
    >>> even_times(0.0, 1.0, 0.4, np.array([0.0, 1.0]))
    array([0. , 0.4, 0.8])
    >>> even_times(0.0, 1e9 + 1.0, 0.5, np.array([0.0, 0.6, 1e9]))
    array([0.0e+00, 5.0e-01, 1.0e+09])
    """
    if (end_s - begin_s) / step_s <= MOST_TIMES:
        return np.arange(begin_s, end_s, step_s)
    known = np.unique(np.concatenate(stamps_s))
    known = known[(known >= begin_s) & (known < end_s)]
    ends = np.flatnonzero(np.diff(known) > _LONGEST_PAUSE_S)
    firsts = np.ceil((known[np.append(0, ends + 1)] - begin_s) / step_s)
    lasts = np.floor((known[np.append(ends, len(known) - 1)] - begin_s) / step_s)
    if (count := float((lasts - firsts + 1.0).sum())) > MOST_TIMES:
        raise BagError(
            f"the stamps in headers reach over {end_s - begin_s:.0f} s, of which {count:.0f} "
            f"times would be compared; the limit is {MOST_TIMES} (MOST_TIMES)"
        )
    steps = [np.arange(a, b + 1.0) for a, b in zip(firsts, lasts, strict=True)]
    return begin_s + step_s * np.concatenate(steps)


def even_spans(
    begin_s: float, end_s: float, step_s: float, *stamps_s: Floats
) -> tuple[Floats, Floats]:
    """Return where the spans between even times begin and end; those over pauses are left out.

    As `even_times`, errors included.
    """
    times_s = even_times(begin_s, end_s, step_s, *stamps_s)
    from_s, to_s = times_s[:-1], times_s[1:]
    whole = to_s - from_s < 1.5 * step_s
    return from_s[whole], to_s[whole]


def nearest(times_s: Floats, wanted_s: Floats) -> Ints:
    """Return the index of the time nearest to each wanted one; times ascend."""
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(1, len(times_s) - 1))
    before = after - 1
    if len(times_s) == 1:
        return np.zeros(len(wanted_s), dtype=np.int64)
    closer = wanted_s - times_s[before] <= times_s[after] - wanted_s
    return np.where(closer, before, after)
