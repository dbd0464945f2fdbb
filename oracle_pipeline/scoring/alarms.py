"""Alarms while a robot runs, raised window by window at a promised rate of false alarms per hour.

The statistic scans the last minute [1]_. For the latest 1, 2, ... windows, it sums the excess of
their scores over the usual score, and divides by the largest such sum in normal recordings. So one
window beyond all normal ones raises an alarm at once, and many slightly unusual windows raise one
slowly. A minute after the last unusual window, the statistic is low again.

An alarm begins a silence. Only news ends it early: a window that is much farther out by itself, or
is unusual in another family of features. The promised rate is that of silences.

The threshold comes from normal recordings, each scored by a model that did not see its block. It is
the lowest at which a new block of the same kind keeps the promised rate on average (conformal risk
control [2]_). The recordings of a block are processed in sequence, like those of one day. Blocks
are the exchangeable units, so recordings and windows within a block may be dependent.

References
----------
.. [1] T. L. Lai, "Sequential changepoint detection in quality control and dynamical systems",
   Journal of the Royal Statistical Society B 57, 1995: window-limited scans.
.. [2] A. N. Angelopoulos, S. Bates, A. Fisch, L. Lei, T. Schuster, "Conformal risk control", 2022.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.scoring.conformal import ConformalError
from oracle_pipeline.windows import HOP_S, WINDOW_S

MEMORY = round(60.0 / HOP_S)  # length of the scan in windows: one minute
USUAL = 0.95  # share of normal windows whose scores add nothing to the statistic
REPEAT_S = 600.0  # silence after an alarm, unless there is news [s]
MUCH_HIGHER = 2.0  # factor at which the excess of a window is news during a silence
_MIN_REACH = 1e-9  # avoids division by zero where normal windows never exceed the allowance
_ROUNDING = 1e-9  # tolerance for sums of weights
RATE_PER_H = 0.5  # promised false alarms per hour, by default

Floats = NDArray[np.float64]


class AlarmError(ConformalError):
    """The normal recordings are too short to support the promised rate of alarms."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """The statistic has passed the threshold."""

    time_s: float  # end of the window that raised it [s of the recording]
    statistic: float
    threshold: float


@dataclass(frozen=True, slots=True)
class AlarmRule:
    """The condition for an alarm, learned from normal recordings.

    Attributes
    ----------
    allowance : float
        Score up to which a window adds nothing.
    threshold : float
        A statistic above it raises an alarm.
    per_hour : float
        Promised upper bound on false alarms per hour.
    reach : tuple of float, length MEMORY
        Largest sum of 1, 2, ... windows above the allowance in normal recordings.
    """

    allowance: float
    threshold: float
    per_hour: float
    reach: tuple[float, ...] = (1.0,) * MEMORY


class Statistic:
    """The scan of one recording, fed window by window.

    Parameters
    ----------
    rule : AlarmRule
        Provides allowance and reach.
    """

    def __init__(self, rule: AlarmRule) -> None:
        self._rule = rule
        self._last: deque[float] = deque(maxlen=MEMORY)

    def feed(self, score: float) -> float:
        """Add the score of the next window, and return the statistic."""
        self._last.appendleft(score - self._rule.allowance)
        totals = accumulate(self._last)
        return max(total / reach for total, reach in zip(totals, self._rule.reach, strict=False))


class AlarmWatch:
    """Monitors one recording or robot: returns an alarm or None for the score of each window.

    Parameters
    ----------
    rule : AlarmRule

    Examples
    --------
    >>> watch = AlarmWatch(AlarmRule(allowance=1.0, threshold=3.0, per_hour=0.5))
    >>> [watch.feed(end_s, score) is not None
    ...  for end_s, score in ((5.0, 0.5), (7.5, 3.0), (10.0, 3.0), (12.5, 9.0))]
    [False, False, True, False]
    """

    def __init__(self, rule: AlarmRule) -> None:
        self.rule = rule
        self._statistic = Statistic(rule)
        self._silent_until_s = self._raised_s = -math.inf
        self._highest = 0.0  # excess of a single window since the silence began
        self._told: set[str] = set()  # families of this silence

    def feed(self, end_s: float, score: float, families: Sequence[str] = ()) -> Alarm | None:
        """Process the next window; windows must be fed in the order of their ends.

        News in a window that overlaps the one with the last alarm belongs to that alarm.

        Parameters
        ----------
        end_s : float
            End of the window [s of the recording].
        score : float
            From `CrossConformalScorer.window_scores`.
        families : sequence of str
            Families that are unusual in this window, the farthest first, from
            `CrossConformalScorer.window_families`; without them only its score can be news.
        """
        statistic = self._statistic.feed(score)
        excess = (score - self.rule.allowance) / self.rule.reach[0]
        is_silent = end_s < self._silent_until_s
        if statistic <= self.rule.threshold or (is_silent and not self._is_news(excess, families)):
            return None
        if not is_silent:
            self._silent_until_s, self._highest, self._told = end_s + REPEAT_S, 0.0, set()
        self._highest = max(self._highest, excess)
        self._told.update(families)
        if is_silent and end_s - self._raised_s < WINDOW_S:
            return None
        self._raised_s = end_s
        return Alarm(end_s, statistic, self.rule.threshold)

    def _is_news(self, excess: float, families: Sequence[str]) -> bool:
        """Return whether a window alone would raise an alarm, and is not what was raised before."""
        known = max(self._highest, self.rule.threshold)
        is_other = bool(families) and families[0] not in self._told
        return excess > (self.rule.threshold if is_other else MUCH_HIGHER * known)


@dataclass(frozen=True, eq=False, slots=True)
class NormalWindows:
    """Held-out scores of the windows of normal recordings, in order of time.

    Attributes
    ----------
    scores, start_s : ndarray of shape (n_windows,)
        Start in seconds of the recording.
    run : ndarray of int, shape (n_windows,)
        Index of the recording of each window, ascending.
    block : ndarray of int, shape (n_runs,)
        Block of each recording.
    """

    scores: Floats
    start_s: Floats
    run: NDArray[np.intp]
    block: NDArray[np.int64]

    def rule(self, per_hour: float = RATE_PER_H) -> AlarmRule:
        """Return the rule with the lowest threshold that keeps a rate of false alarms.

        Parameters
        ----------
        per_hour : float
            False alarms per hour, on average over recordings.

        Raises
        ------
        AlarmError
            There are not enough hours of normal recordings for this rate.
        """
        clock = self._clock()
        allowed = per_hour * clock.hours - clock.most
        if allowed < -_ROUNDING:
            raise AlarmError(
                f"{len(np.unique(self.block))} blocks of normal recordings ({clock.hours:.2g} h) "
                f"support no rate below {self.lowest_rate():.2g} false alarms per hour; a rate of "
                f"{per_hour:g} needs {-allowed / per_hour:.2g} h more, with other starts or days."
            )
        allowance = float(np.quantile(self.scores, USUAL))
        excess = self.scores - allowance
        reach = tuple(
            max(clock.lowest_threshold(total, allowed), _MIN_REACH)
            for total in totals_of(excess, self.run)
        )
        statistic = statistics_of(self.scores, self.run, AlarmRule(allowance, 0.0, per_hour, reach))
        threshold = clock.lowest_threshold(statistic, allowed)
        return AlarmRule(allowance, threshold, per_hour, reach)

    def lowest_rate(self) -> float:
        """Return the lowest rate of false alarms that these recordings support [1/h]."""
        clock = self._clock()
        return clock.most / clock.hours if clock.hours else math.inf

    def without(self, block: int) -> "NormalWindows":
        """Return the windows of all other blocks, for judging a recording of this block."""
        others = self.block != block
        kept = others[self.run]
        number = (np.cumsum(others) - 1).astype(np.intp)
        return NormalWindows(
            self.scores[kept], self.start_s[kept], number[self.run[kept]], self.block[others]
        )

    def _clock(self) -> "_Clock":
        """Return the time of each window in its block, with the block's recordings in sequence."""
        duration_s = np.zeros(len(self.block))  # of each recording, up to its last window
        np.maximum.at(duration_s, self.run, self.start_s + HOP_S)
        number = np.unique(self.block, return_inverse=True)[1]
        length_s = np.bincount(number, duration_s)
        begin_s = np.empty(len(self.block))
        for block in range(len(length_s)):
            in_block = np.flatnonzero(number == block)
            begin_s[in_block] = np.cumsum(duration_s[in_block]) - duration_s[in_block]
        typical_s = float(np.median(length_s)) if len(length_s) else 0.0
        weight = np.minimum(1.0, typical_s / np.maximum(length_s, HOP_S))
        most = np.maximum(1.0, weight * np.ceil(length_s / REPEAT_S)).max(initial=1.0)
        return _Clock(
            begin_s[self.run] + self.start_s + WINDOW_S,
            number[self.run],
            weight,
            float(weight @ length_s) / 3600.0,
            float(most),
        )


@dataclass(frozen=True, eq=False, slots=True)
class _Clock:
    """The end times of normal windows, with the recordings of each block in sequence.

    A block that is longer than the median block is weighted down to the median length.
    """

    end_s: Floats  # of each window, since the start of its block
    block: NDArray[np.intp]  # of each window, from 0
    weight: Floats  # of each block
    hours: float  # weighted sum over all blocks
    most: float  # largest possible weighted number of alarms in one block

    def alarms(self, statistic: Floats, threshold: float) -> float:
        """Return the number of alarms above a threshold, weighted by block."""
        above = np.flatnonzero(statistic > threshold)
        block, end_s = self.block[above], self.end_s[above]
        count, until_s = 0.0, np.full(len(self.weight), -math.inf)
        while len(above):
            raising, first = np.unique(block, return_index=True)
            count += float(self.weight[raising].sum())
            until_s[raising] = end_s[first] + REPEAT_S
            later = end_s >= until_s[block]
            above, block, end_s = above[later], block[later], end_s[later]
        return count

    def lowest_threshold(self, statistic: Floats, allowed: float) -> float:
        """Return the lowest threshold that at most the allowed number of alarms exceed."""
        candidates = np.unique(statistic[np.isfinite(statistic)])
        low, high = 0, len(candidates) - 1  # the highest candidate raises no alarm
        if high < 0:
            return math.inf
        while low < high:
            middle = (low + high) // 2
            if self.alarms(statistic, float(candidates[middle])) <= allowed + _ROUNDING:
                high = middle
            else:
                low = middle + 1
        return float(candidates[low])


def totals_of(excess: Floats, run: NDArray[np.intp]) -> Iterator[Floats]:
    """Yield the sums of the latest 1, 2, ... windows; -inf where a recording has fewer.

    Parameters
    ----------
    excess : ndarray of shape (n_windows,)
        Scores above the allowance.
    run : ndarray of int, shape (n_windows,)
        Ascending; the windows of a recording are in order of time.
    """
    total = excess
    yield total
    for back in range(1, MEMORY):
        earlier = np.full(len(excess), -math.inf)
        same = run[back:] == run[:-back]
        earlier[back:][same] = excess[:-back][same]
        total = total + earlier
        yield total


def statistics_of(scores: Floats, run: NDArray[np.intp], rule: AlarmRule) -> Floats:
    """Return the statistic of the windows of many recordings, shape (n_windows,).

    Parameters
    ----------
    scores : ndarray of shape (n_windows,)
    run : ndarray of int, shape (n_windows,)
        As for `totals_of`.
    rule : AlarmRule
        Provides allowance and reach.
    """
    highest = np.full(len(scores), -math.inf)
    for total, reach in zip(totals_of(scores - rule.allowance, run), rule.reach, strict=True):
        if math.isfinite(reach):  # infinite: no normal recording had that many windows
            highest = np.maximum(highest, total / reach)
    return highest
