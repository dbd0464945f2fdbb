"""Permutation tests over many features at once, with family-wise error control.

The largest statistic over all features is compared with its own permutation distribution
(step-down maxT [1]_), so features may depend on each other in any way. The statistics are
differences of means over their standard errors. Ranks would be too coarse: with few recordings,
many features reach the largest rank sum by chance. A recording may have several rows, one for each
robot: they share its day, so they stay together in every permutation.

References
----------
.. [1] P. H. Westfall, S. S. Young, "Resampling-Based Multiple Testing", Wiley 1993, algorithm 2.8.
"""

import math
from abc import ABC, abstractmethod
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Indices = NDArray[np.intp]

DRAWN = 9_999  # number of random assignments if there are too many to enumerate
_AT_ONCE = 1_000  # assignments processed at once, to limit memory
# Added to each standard error, in standard deviations of the feature: a feature with only two
# values has a standard error of 0 if they separate the sets by chance.
_LEAST_ERROR = 0.05


class PermutationDesign(ABC):
    """The possible assignments of recordings to the two sets, if the sets do not differ."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of assignments, including the real one."""

    @property
    @abstractmethod
    def real(self) -> Numbers:
        """The real assignment, shape (n_units,)."""

    @abstractmethod
    def every_assignment(self) -> Numbers:
        """Return all assignments, shape (size, n_units)."""

    @abstractmethod
    def drawn_assignments(self, number: int, rng: np.random.Generator) -> Numbers:
        """Return random assignments, shape (number, n_units)."""

    @abstractmethod
    def t(self, assignments: Numbers) -> Numbers:
        """Return the statistic, shape (n_assignments, n_features).

        It is positive if the second set has larger values, and 0 if a feature does not differ.
        """

    @abstractmethod
    def effect(self) -> Numbers:
        """Return the effect size from -1 to 1, shape (n_features,)."""

    @property
    def lowest_p(self) -> float:
        """The smallest possible two-sided p-value."""
        return max(2.0 / self.size, 1.0 / (DRAWN + 1))


class TwoSamples(PermutationDesign):
    """Recordings without a partner: Welch's statistic.

    Parameters
    ----------
    first, second : ndarray of shape (n_first, n_features), (n_second, n_features)
        NaN where a feature is missing.
    recordings : pair of ndarray of shape (n_first,), (n_second,), optional
        Number of each row's recording in its set, from 0; by default each row is one.
    """

    def __init__(
        self, first: Numbers, second: Numbers, recordings: tuple[Indices, Indices] | None = None
    ) -> None:
        self._first, self._second = first, second
        own = recordings or (np.arange(len(first)), np.arange(len(second)))
        self._sizes = tuple(int(each.max()) + 1 for each in own)
        self._recording = np.concatenate([own[0], self._sizes[0] + own[1]])
        values = np.concatenate([first, second])
        observed = np.isfinite(values)
        self._observed = observed.astype(np.float64)
        total = np.maximum(observed.sum(axis=0), 1.0)
        centred = np.where(observed, values, 0.0)
        centred = np.where(observed, centred - centred.sum(axis=0) / total, 0.0)
        self._values = _ratio(centred, np.sqrt(np.square(centred).sum(axis=0) / total))

    @property
    def size(self) -> int:
        """Number of ways to choose the second set."""
        return math.comb(sum(self._sizes), self._sizes[1])

    @property
    def real(self) -> Numbers:
        """1 for a recording of the second set, shape (n_recordings,)."""
        return np.repeat([0.0, 1.0], self._sizes)

    def every_assignment(self) -> Numbers:
        """Return every choice of the second set."""
        n = sum(self._sizes)
        assignments = np.zeros((self.size, n))
        for row, chosen in enumerate(combinations(range(n), self._sizes[1])):
            assignments[row, chosen] = 1.0
        return assignments

    def drawn_assignments(self, number: int, rng: np.random.Generator) -> Numbers:
        """Return random choices of the second set."""
        return np.asarray(rng.permuted(np.tile(self.real, (number, 1)), axis=1), dtype=np.float64)

    def t(self, assignments: Numbers) -> Numbers:
        """Return the difference of the means over its standard error."""
        of_rows = assignments[:, self._recording]
        mean, variance = self._moments(of_rows)
        others_mean, others_variance = self._moments(1.0 - of_rows)
        return (mean - others_mean) / (np.sqrt(variance + others_variance) + _LEAST_ERROR)

    def _moments(self, chosen: Numbers) -> tuple[Numbers, Numbers]:
        """Return the mean of the chosen rows and its variance; 0 without values."""
        n = chosen @ self._observed
        mean = _ratio(chosen @ self._values, n)
        squares = _ratio(chosen @ np.square(self._values), n) - np.square(mean)
        return mean, _ratio(np.maximum(squares, 0.0), np.maximum(n - 1.0, 0.0))

    def effect(self) -> Numbers:
        """Return Cliff's delta: P(second > first) - P(second < first)."""
        signs = np.sign(self._second[:, None] - self._first[None])
        return np.asarray(np.nan_to_num(np.nanmean(signs, axis=(0, 1))), dtype=np.float64)


class MatchedPairs(PermutationDesign):
    """Recordings with a partner of the same start and goals: the paired t statistic.

    Parameters
    ----------
    first, second : ndarray of shape (n_pairs, n_features)
        NaN where a recording lacks a feature.
    """

    def __init__(self, first: Numbers, second: Numbers) -> None:
        difference = np.nan_to_num(second - first)
        self._pairs = len(difference)
        size = np.sqrt(np.square(difference).mean(axis=0))
        self._differences = _ratio(difference, size)

    @property
    def size(self) -> int:
        """Number of ways to swap the partners of pairs."""
        return int(2**self._pairs)

    @property
    def real(self) -> Numbers:
        """1 for an unswapped pair, -1 for a swapped one, shape (n_pairs,)."""
        return np.ones(self._pairs)

    def every_assignment(self) -> Numbers:
        """Return every way to swap partners."""
        return np.array(list(product((1.0, -1.0), repeat=self._pairs)))

    def drawn_assignments(self, number: int, rng: np.random.Generator) -> Numbers:
        """Return random ways to swap partners."""
        return rng.choice([1.0, -1.0], size=(number, self._pairs))

    def t(self, assignments: Numbers) -> Numbers:
        """Return the mean difference over its standard error."""
        mean = assignments @ self._differences / self._pairs
        variance = np.maximum(1.0 - np.square(mean), 0.0) / (self._pairs - 1)
        return mean / (np.sqrt(variance) + _LEAST_ERROR)

    def effect(self) -> Numbers:
        """Return the share of pairs with a larger second value minus that with a smaller one."""
        return np.asarray(np.sign(self._differences).mean(axis=0), dtype=np.float64)


def adjusted_p_values(design: PermutationDesign, rng: np.random.Generator) -> Numbers:
    """Return a p-value for each feature, adjusted for all of them, shape (n_features,).

    If the sets do not differ, the probability of any p-value at or below a level is at most that
    level.

    Parameters
    ----------
    design : PermutationDesign
        Its assignments are enumerated if there are few, or else drawn.
    rng : Generator
        Draws assignments.
    """
    if design.size <= DRAWN + 1:
        assignments = design.every_assignment()
    else:
        assignments = np.concatenate([design.real[None], design.drawn_assignments(DRAWN, rng)])
    observed = np.abs(design.t(design.real[None])[0])
    order = np.argsort(observed, kind="stable")  # smallest first
    reached = np.zeros(len(observed))
    for start in range(0, len(assignments), _AT_ONCE):
        t = np.abs(design.t(assignments[start : start + _AT_ONCE]))[:, order]
        largest = np.maximum.accumulate(t, axis=1)
        reached += np.sum(largest >= observed[order] - 1e-9, axis=0)  # tolerates rounding
    p = reached / len(assignments)
    stepped = np.maximum.accumulate(p[::-1])[::-1]  # p-values decrease with the statistic
    return stepped[np.argsort(order, kind="stable")]


def _ratio(numerator: Numbers, denominator: Numbers) -> Numbers:
    """Divide; 0 where the denominator is not positive."""
    shape = np.broadcast_shapes(numerator.shape, denominator.shape)
    denominator = np.broadcast_to(denominator, shape)
    return np.divide(numerator, denominator, out=np.zeros(shape), where=denominator > 0.0)
