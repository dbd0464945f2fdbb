"""Confusion matrix, rates, AUC and ROC curve over distinct runs.

Rows may be copies (a bootstrap draws them): every metric here takes one value a *run* and weights
it by the run's copies, so the figure is that of the rows, while its interval is that of the runs.
Runs of one block share start, goals and nuisance seed, so resampling draws blocks.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.datasets import DistinctRuns
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
    """A figure is asked of numbers that cannot give it."""


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


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else np.nan


def confusion(flagged: NDArray[np.bool_], runs: DistinctRuns) -> Confusion:
    """Count rows by truth and verdict.

    Parameters
    ----------
    flagged : ndarray of bool, shape (n_runs,)
        The verdict on each distinct run.
    """

    def rows(these: NDArray[np.bool_]) -> int:
        return int(runs.copies[these].sum())

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


def auc(score: NDArray[np.float64], runs: DistinctRuns, rng: np.random.Generator) -> Estimate:
    """Return the chance that a malicious row scores above another one, ties counting half.

    Of a hard verdict (0 or 1) this is the balanced accuracy.

    Parameters
    ----------
    score : ndarray of shape (n_runs,)
        Higher is more anomalous; runs scored NaN are left out.
    runs : DistinctRuns
    rng : Generator
        Draws the blocks.

    Returns
    -------
    Estimate
        The wider, on each side, of the percentiles over resampled blocks and Newcombe's interval
        for that many distinct runs: a few blocks that happen to be separated show no doubt when
        resampled. Nothing if a class is missing.
    """
    score, malicious, copies, block = _scored(score, runs)
    n_malicious = int(malicious.sum())
    if n_malicious in (0, len(malicious)):
        return NOTHING
    drawn = copies * _resampled(block, rng)
    values = _aucs(score, malicious, np.vstack([copies, drawn]))
    bound = newcombe_auc(float(values[0]), n_malicious, len(malicious) - n_malicious)
    low, high = np.nanpercentile(values, BAND)
    return Estimate(bound.value, min(bound.low, float(low)), max(bound.high, float(high)))


@dataclass(frozen=True, eq=False, slots=True)
class RocCurve:
    """A ROC curve with a pointwise 95% band; arrays of shape (n_points,)."""

    fpr: NDArray[np.float64]
    tpr: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def roc_curve(score: NDArray[np.float64], runs: DistinctRuns, rng: np.random.Generator) -> RocCurve:
    """Return the ROC curve of a score on a regular grid of false-positive rates.

    Parameters are those of `auc`. The band is that of resampled blocks and tells nothing of blocks
    that were not recorded.

    Raises
    ------
    MetricError
        A class is missing.
    """
    score, malicious, copies, block = _scored(score, runs)
    if malicious.all() or not malicious.any():
        raise MetricError("A ROC curve needs runs of both classes; record both.")
    weights = np.vstack([copies, copies * _resampled(block, rng)])
    grid = np.linspace(0.0, 1.0, 101)
    curves = []
    for positive, negative in zip(*_by_score(score, malicious, weights), strict=True):
        if positive.sum() and negative.sum():
            # From the highest score down; the curve joins the points of distinct scores.
            x = np.append(0.0, np.cumsum(negative[::-1])) / negative.sum()
            y = np.append(0.0, np.cumsum(positive[::-1])) / positive.sum()
            curves.append(np.interp(grid, x, y))
    low, high = np.percentile(curves, BAND, axis=0)
    return RocCurve(grid, curves[0], np.minimum(low, curves[0]), np.maximum(high, curves[0]))


def _scored(
    score: NDArray[np.float64], runs: DistinctRuns
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.int64]]:
    known = ~np.isnan(score)
    return (
        score[known],
        runs.malicious[known],
        runs.copies[known].astype(np.float64),
        runs.block[known],
    )


def _resampled(block: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return how often each run is drawn when blocks are, shape (RESAMPLES, n_runs)."""
    names, member = np.unique(block, return_inverse=True)
    shares = np.full(len(names), 1.0 / len(names))
    return rng.multinomial(len(names), shares, size=RESAMPLES)[:, member].astype(np.float64)


def _by_score(
    score: NDArray[np.float64], malicious: NDArray[np.bool_], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sum the weights of either class by distinct score, ascending; (n_weightings, n_scores)."""
    order = np.argsort(score, kind="stable")
    starts = np.flatnonzero(np.diff(score[order], prepend=-np.inf))
    weights, malicious = weights[:, order], malicious[order]
    return (
        np.add.reduceat(weights * malicious, starts, axis=1),
        np.add.reduceat(weights * ~malicious, starts, axis=1),
    )


def _aucs(
    score: NDArray[np.float64], malicious: NDArray[np.bool_], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return one AUC a weighting; NaN where a class has no weight."""
    positive, negative = _by_score(score, malicious, weights)
    below = np.cumsum(negative, axis=1) - negative / 2.0
    pairs = positive.sum(axis=1) * negative.sum(axis=1)
    wins = (positive * below).sum(axis=1)
    values = np.full(len(pairs), np.nan)
    np.divide(wins, pairs, out=values, where=pairs > 0)
    return values


def decode_thesis_row(tpr: float, auc: float) -> float:
    """Return the false-positive rate behind an "accuracy" and an AUC of the thesis.

    Its "accuracy" is a true-positive rate and its AUC is that of a hard verdict,
    ``(TPR + 1 - FPR) / 2``, so the rate it does not print follows.

    Raises
    ------
    MetricError
        No rate in [0, 1] fits both figures, rounding aside.

    Examples
    --------
    >>> round(decode_thesis_row(tpr=0.953, auc=0.504), 3)
    0.945
    """
    fpr = tpr + 1.0 - 2.0 * auc
    if not -0.005 <= fpr <= 1.005:
        raise MetricError(
            f"A recall of {tpr} and an AUC of {auc} give a false-positive rate of {fpr:.3f}; "
            "one of the two is not of a hard verdict."
        )
    return min(max(fpr, 0.0), 1.0)
