"""Alarms while a robot runs: window by window, with a promised number of false alarms an hour.

The statistic is a window-limited CUSUM [1]_: how far the scores of the last minute lie above what
is usual, from the start that makes most of it. One window that is far out raises it at once, many
that are a little out raise it slowly, and a minute after the last of them it is low again.

The threshold comes from normal recordings, each scored by a model that did not see its block. It is
the lowest for which a new recording of the same kind keeps the promised rate on average (conformal
risk control [2]_). A recording is one unit, so it does not matter how its windows depend on each
other, and a block of recordings has one vote.

References
----------
.. [1] T. L. Lai, "Sequential changepoint detection in quality control and dynamical systems",
   Journal of the Royal Statistical Society B 57, 1995.
.. [2] A. N. Angelopoulos, S. Bates, A. Fisch, L. Lei, T. Schuster, "Conformal risk control", 2022.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.scoring.conformal import ConformalError
from oracle_pipeline.windows import HOP_S, WINDOW_S

MEMORY = 12  # windows that the statistic looks back: a minute
USUAL = 0.95  # share of normal windows whose scores add nothing to the statistic
REPEAT_S = 600.0  # after an alarm no other is raised for so long [s]
RATE_PER_H = 0.5  # false alarms an hour that are promised unless another rate is asked for

Floats = NDArray[np.float64]


class AlarmError(ConformalError):
    """The normal recordings are too few hours for the promised rate of alarms."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """The statistic has passed the threshold."""

    time_s: float  # end of the window that raised it [s of the recording]
    statistic: float
    threshold: float


@dataclass(frozen=True, slots=True)
class AlarmRule:
    """When an alarm is raised; learned from normal recordings.

    Attributes
    ----------
    allowance : float
        Score up to which a window adds nothing.
    threshold : float
        An alarm is raised above it.
    per_hour : float
        False alarms an hour that are promised at most.
    """

    allowance: float
    threshold: float
    per_hour: float


class Statistic:
    """The window-limited CUSUM of one recording, fed window by window.

    Parameters
    ----------
    allowance : float
        As of `AlarmRule`.
    """

    def __init__(self, allowance: float) -> None:
        self._allowance = allowance
        self._last: deque[float] = deque(maxlen=MEMORY)

    def feed(self, score: float) -> float:
        """Take the score of the next window, and return the statistic."""
        self._last.appendleft(score - self._allowance)
        highest, total = -math.inf, 0.0
        for excess in self._last:
            total += excess
            highest = max(highest, total)
        return highest


class AlarmWatch:
    """Watches one recording or robot: give it each window's score, get an alarm or none.

    Parameters
    ----------
    rule : AlarmRule

    Examples
    --------
    >>> watch = AlarmWatch(AlarmRule(allowance=1.0, threshold=3.0, per_hour=0.5))
    >>> [watch.feed(end_s, score) is not None
    ...  for end_s, score in ((10.0, 0.5), (15.0, 3.0), (20.0, 3.0), (25.0, 9.0))]
    [False, False, True, False]
    """

    def __init__(self, rule: AlarmRule) -> None:
        self.rule = rule
        self._statistic = Statistic(rule.allowance)
        self._silent_until_s = -math.inf

    def feed(self, end_s: float, score: float) -> Alarm | None:
        """Take the next window; windows come in the order of their ends.

        Parameters
        ----------
        end_s : float
            End of the window [s of the recording].
        score : float
            As of `CrossConformalScorer.window_scores`.
        """
        statistic = self._statistic.feed(score)
        if statistic <= self.rule.threshold or end_s < self._silent_until_s:
            return None
        self._silent_until_s = end_s + REPEAT_S
        return Alarm(end_s, statistic, self.rule.threshold)


@dataclass(frozen=True, eq=False, slots=True)
class NormalWindows:
    """Held-out scores of the windows of normal recordings, in the order of time.

    Attributes
    ----------
    scores, start_s : ndarray of shape (n_windows,)
        Start in seconds of the recording.
    run : ndarray of int, shape (n_windows,)
        Which recording each belongs to, ascending.
    block : ndarray of int, shape (n_runs,)
        Of each recording.
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
            False alarms an hour, on average over recordings.

        Raises
        ------
        AlarmError
            There are not enough hours of normal recordings for this rate.
        """
        vote, most = self._votes(), self._most_alarms()
        hours = float(vote @ self._hours())
        if self.lowest_rate() > per_hour:
            raise AlarmError(
                f"{len(np.unique(self.block))} blocks of normal recordings ({hours:.2g} h, one "
                f"recording of each) support no rate below {self.lowest_rate():.2g} false alarms "
                f"an hour; {per_hour:g} takes {most / per_hour - hours:.2g} h more, of other "
                "starts or days."
            )
        allowance = float(np.quantile(self.scores, USUAL))
        statistic = statistics_of(self.scores, self.run, allowance)
        lowest = self._lowest_threshold(statistic, per_hour * hours - most)
        candidates = np.unique(np.append(statistic[statistic > lowest], lowest))
        low, high = 0, len(candidates) - 1  # above the highest there is no alarm at all
        while low < high:
            middle = (low + high) // 2
            alarms = float(vote @ self._alarms(statistic, float(candidates[middle])))
            if alarms + most <= per_hour * hours:
                high = middle
            else:
                low = middle + 1
        return AlarmRule(allowance, float(candidates[low]), per_hour)

    def lowest_rate(self) -> float:
        """Return the lowest rate of false alarms that these recordings support [1/h]."""
        hours = float(self._votes() @ self._hours())
        return self._most_alarms() / hours if hours else math.inf

    def without(self, block: int) -> "NormalWindows":
        """Return the windows of all other blocks: those that may judge a recording of this one."""
        others = self.block != block
        kept = others[self.run]
        number = (np.cumsum(others) - 1).astype(np.intp)
        return NormalWindows(
            self.scores[kept], self.start_s[kept], number[self.run[kept]], self.block[others]
        )

    def _votes(self) -> Floats:
        """Return the vote of each recording: those of a block share one."""
        _, number, size = np.unique(self.block, return_inverse=True, return_counts=True)
        return np.asarray(1.0 / size[number], dtype=np.float64)

    def _lowest_threshold(self, statistic: Floats, allowed: float) -> float:
        """Return the threshold above which recordings of no more than `allowed` votes come at all.

        A recording gives one alarm at least if its statistic passes the threshold.
        """
        highest = np.zeros(len(self.block))
        np.maximum.at(highest, self.run, statistic)
        order = np.argsort(highest)
        above = np.cumsum(self._votes()[order][::-1])[::-1] - self._votes()[order]
        enough = above <= allowed + 1e-9
        return float(highest[order][enough.argmax()])

    def _hours(self) -> Floats:
        """Return how long each recording was watched, from its start to its last window [h]."""
        ends = np.zeros(len(self.block))
        np.maximum.at(ends, self.run, self.start_s + HOP_S)
        return ends / 3600.0

    def _most_alarms(self) -> int:
        """Return how many alarms a recording as long as the longest could have."""
        return max(1, math.ceil(3600.0 * float(self._hours().max(initial=0.0)) / REPEAT_S))

    def _alarms(self, statistic: Floats, threshold: float) -> Floats:
        """Return how many alarms each recording has, shape (n_runs,)."""
        count, until_s = np.zeros(len(self.block)), np.full(len(self.block), -math.inf)
        for window in np.flatnonzero(statistic > threshold).tolist():
            run, end_s = self.run[window], self.start_s[window] + WINDOW_S
            if end_s >= until_s[run]:
                count[run] += 1.0
                until_s[run] = end_s + REPEAT_S
        return count


def statistics_of(scores: Floats, run: NDArray[np.intp], allowance: float) -> Floats:
    """Return the statistic of the windows of many recordings, shape (n_windows,).

    Parameters
    ----------
    scores : ndarray of shape (n_windows,)
    run : ndarray of int, shape (n_windows,)
        Ascending; a recording's windows in the order of time.
    allowance : float
        As of `AlarmRule`.
    """
    excess = scores - allowance
    highest, total = excess.copy(), excess.copy()
    for back in range(1, MEMORY):
        earlier = np.zeros_like(excess)
        same = np.zeros(len(run), dtype=np.bool_)
        same[back:] = run[back:] == run[: len(run) - back] if len(run) > back else False
        earlier[back:][same[back:]] = excess[: len(run) - back][same[back:]]
        total = total + earlier
        highest = np.where(same, np.maximum(highest, total), highest)
    return highest
