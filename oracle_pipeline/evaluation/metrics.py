"""Confusion matrix, rates and AUC over distinct runs.

Rows may be copies drawn by a bootstrap: every metric here takes one value for each *run* and
weights it by the number of copies. So the value is that of the rows, and the interval that of the
runs. Runs of one block share start, goals and nuisance seed, so resampling draws blocks. For runs
without copies (our own evaluation), `share` gives a rate with an interval that respects blocks.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.evaluation.estimate import (
    LEVEL,
    NOTHING,
    Estimate,
    clopper_pearson,
    newcombe_auc,
)

RESAMPLES = 2000
BAND = [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)]  # percentiles


class MetricError(OracleError):
    """A metric cannot be computed from these numbers."""


@dataclass(frozen=True, slots=True)
class Confusion:
    """Rows by truth (malicious is positive) and verdict (anomalous is positive)."""

    tp: int
    fp: int
    fn: int
    tn: int

    @property
    def tpr(self) -> float:
        """Share of malicious rows called anomalous; NaN if there are none."""
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def fpr(self) -> float:
        """Share of other rows called anomalous; NaN if there are none."""
        return _ratio(self.fp, self.fp + self.tn)

    @property
    def mcc(self) -> float:
        """Matthews' correlation; 0 if all verdicts are equal, NaN if a class is missing."""
        if self.tp + self.fn == 0 or self.fp + self.tn == 0:
            return np.nan
        margins = [self.tp + self.fp, self.tp + self.fn, self.tn + self.fp, self.tn + self.fn]
        product = float(np.prod(np.array(margins, dtype=np.float64)))
        return (self.tp * self.tn - self.fp * self.fn) / np.sqrt(product) if product else 0.0


def select(runs: DistinctRuns, mask: NDArray[np.bool_]) -> DistinctRuns:
    """Return the runs of a mask."""
    return DistinctRuns(runs.first[mask], runs.copies[mask], runs.malicious[mask], runs.block[mask])


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else np.nan


def confusion(flagged: NDArray[np.bool_], runs: DistinctRuns) -> Confusion:
    """Count rows by truth and verdict.

    Parameters
    ----------
    flagged : ndarray of bool, shape (n_runs,)
        The verdict on each distinct run.
    """

    def rows(mask: NDArray[np.bool_]) -> int:
        return int(runs.copies[mask].sum())

    return Confusion(
        tp=rows(flagged & runs.malicious),
        fp=rows(flagged & ~runs.malicious),
        fn=rows(~flagged & runs.malicious),
        tn=rows(~flagged & ~runs.malicious),
    )


def true_positive_rate(flagged: NDArray[np.bool_], runs: DistinctRuns) -> Estimate:
    """Return the share of malicious rows flagged; Clopper-Pearson interval on distinct runs."""
    return clopper_pearson(confusion(flagged, runs).tpr, int(runs.malicious.sum()))


def false_positive_rate(flagged: NDArray[np.bool_], runs: DistinctRuns) -> Estimate:
    """Return the share of other rows flagged; Clopper-Pearson interval on distinct runs."""
    return clopper_pearson(confusion(flagged, runs).fpr, int((~runs.malicious).sum()))


def share(
    hit: NDArray[np.bool_], block: NDArray[np.int64], rng: np.random.Generator, level: float = LEVEL
) -> Estimate:
    """Return the share of runs that are hit, for example the share of attacks detected.

    Parameters
    ----------
    hit : ndarray of bool, shape (n,)
        One value per run.
    block : ndarray of shape (n,)
    rng : Generator
        Draws the blocks.
    level : float
        Of confidence, two-sided: the lower end at 0.90 is the one-sided 95% bound.

    Returns
    -------
    Estimate
        The interval is, on each side, the wider of the Clopper-Pearson interval on runs and the
        percentiles over resampled blocks. `NOTHING` without runs.
    """
    if len(hit) == 0:
        return NOTHING
    member = np.unique(block, return_inverse=True)[1]
    runs, hits = np.bincount(member), np.bincount(member, weights=hit)
    draws = _resampled(len(runs), rng)
    return _wider(
        clopper_pearson(float(np.mean(hit)), len(hit), level), draws @ hits / (draws @ runs), level
    )


def quantile(
    values: NDArray[np.float64], block: NDArray[np.int64], q: float, rng: np.random.Generator
) -> Estimate:
    """Return a quantile of values that may be infinite (censored); percentiles over blocks.

    Parameters are those of `share`. The quantile is one of the values, the lower of two.
    """
    if len(values) == 0:
        return NOTHING
    member = np.unique(block, return_inverse=True)[1]
    occurring, place = np.unique(values, return_inverse=True)
    counts = np.zeros((member.max() + 1, len(occurring)))
    np.add.at(counts, (member, place), 1.0)
    draws = np.vstack([np.ones(len(counts)), _resampled(len(counts), rng)])
    reached = np.cumsum(draws @ counts, axis=1)
    first = (reached >= q * reached[:, -1:] - 1e-9).argmax(axis=1)
    low, high = np.percentile(first[1:], BAND, method="nearest").astype(int)
    return Estimate(*(float(occurring[place]) for place in (first[0], low, high)))


def events_per_hour(
    events: NDArray[np.int64],
    seconds: NDArray[np.float64],
    block: NDArray[np.int64],
    rng: np.random.Generator,
) -> Estimate:
    """Return a rate of events over runs of given lengths.

    The interval is, on each side, the wider of Garwood's for Poisson counts and the percentiles
    over resampled blocks.
    """
    hours = float(np.sum(seconds)) / 3600.0
    if hours == 0.0:
        return NOTHING
    n, tail = int(np.sum(events)), (1.0 - LEVEL) / 2.0
    low = gammaincinv(n, tail) if n else 0.0
    exact = Estimate(n / hours, float(low) / hours, float(gammaincinv(n + 1, 1.0 - tail)) / hours)
    member = np.unique(block, return_inverse=True)[1]
    draws = _resampled(int(member.max()) + 1, rng)
    counts = draws @ np.bincount(member, weights=events)
    return _wider(exact, 3600.0 * counts / (draws @ np.bincount(member, weights=seconds)), LEVEL)


def auc(
    score: NDArray[np.float64],
    runs: DistinctRuns,
    rng: np.random.Generator,
    level: float = LEVEL,
    within: NDArray[Any] | None = None,
) -> Estimate:
    """Return the probability that a malicious row scores above another row; ties count half.

    For a hard verdict (0 or 1) this is the balanced accuracy.

    Parameters
    ----------
    score : ndarray of shape (n_runs,)
        Higher is more anomalous; runs scored NaN are left out.
    runs : DistinctRuns
    rng : Generator
        Draws the blocks.
    level : float
        Of confidence, two-sided.
    within : ndarray of shape (n_runs,), optional
        A group for each run, such as its mode: only rows of one group are compared.

    Returns
    -------
    Estimate
        The interval is, on each side, the wider of the percentiles over resampled blocks and
        Newcombe's interval for the number of distinct runs, since resampling perfectly separated
        blocks gives no width. `NOTHING` if a class is missing.
    """
    group = np.zeros(len(runs)) if within is None else within
    finite = ~np.isnan(score)
    groups = [finite & (group == name) for name in np.unique(group[finite])]
    both = [members for members in groups if len(np.unique(runs.malicious[members])) == 2]
    if not both:
        return NOTHING
    compared = np.any(both, axis=0)
    n_malicious = int(runs.malicious[compared].sum())
    blocks = np.unique(runs.block[compared])
    draws = np.vstack([np.ones(len(blocks)), _resampled(len(blocks), rng)])
    won, pairs = np.zeros((2, len(draws)))
    for members in both:
        positive, negative = _by_score(score[members], select(runs, members), blocks)
        # Number of pairs, by block of the malicious and of the other row, that the malicious row
        # wins. The AUC for any weights of blocks is then a ratio of quadratic forms.
        wins = positive @ (np.cumsum(negative, axis=1) - negative / 2.0).T
        won += np.einsum("ri,ri->r", draws @ wins, draws)
        pairs += (draws @ positive.sum(axis=1)) * (draws @ negative.sum(axis=1))
    values = np.full(len(pairs), np.nan)
    np.divide(won, pairs, out=values, where=pairs > 0)
    bound = newcombe_auc(float(values[0]), n_malicious, int(compared.sum()) - n_malicious, level)
    return _wider(bound, values[1:], level)


def _resampled(blocks: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the number of draws of each block, shape (RESAMPLES, blocks)."""
    shares = np.full(blocks, 1.0 / blocks)
    return rng.multinomial(blocks, shares, size=RESAMPLES).astype(np.float64)


def _by_score(
    score: NDArray[np.float64], runs: DistinctRuns, blocks: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Count the rows of either class by block and distinct score, ascending."""
    member = np.searchsorted(blocks, runs.block)
    scores, place = np.unique(score, return_inverse=True)
    counts = np.zeros((2, len(blocks), len(scores)))
    np.add.at(counts, (runs.malicious.astype(int), member, place), runs.copies)
    return counts[1], counts[0]


def _wider(bound: Estimate, values: NDArray[np.float64], level: float) -> Estimate:
    """Widen an interval to the percentiles of resampled values."""
    low, high = np.nanpercentile(values, [50.0 * (1.0 - level), 50.0 * (1.0 + level)])
    return Estimate(bound.value, min(bound.low, float(low)), max(bound.high, float(high)))


def decode_thesis_row(tpr: float, auc: float) -> float:
    """Return the false-positive rate behind an "accuracy" and an AUC of the thesis.

    Its "accuracy" is a true-positive rate and its AUC is that of a hard verdict,
    ``(TPR + 1 - FPR) / 2``, so the unpublished rate follows.

    Raises
    ------
    MetricError
        No rate in [0, 1] is consistent with both figures.

    Examples
    --------
    >>> round(decode_thesis_row(tpr=0.953, auc=0.504), 3)
    0.945
    """
    fpr = tpr + 1.0 - 2.0 * auc
    if not -0.005 <= fpr <= 1.005:
        raise MetricError(
            f"A recall of {tpr} and an AUC of {auc} give a false-positive rate of {fpr:.3f}; "
            "they are not from the same hard verdict."
        )
    return min(max(fpr, 0.0), 1.0)
