"""Scores of runs by detectors that were not fitted on their block, calibrated to one scale.

In every fold (`splits`) a new detector is fitted, and scores the calibration and test rows. Higher
scores are more anomalous. Arrays of scores have one row per fold, with NaN for runs that are
neither calibration nor test rows of the fold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import clone

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.datasets import feature_floors
from oracle_pipeline.detectors import Detector, pipeline
from oracle_pipeline.evaluation.splits import Fold
from oracle_pipeline.scoring.conformal import p_values
from oracle_pipeline.scoring.measured_runs import MeasuredRuns


@dataclass(frozen=True, eq=False, slots=True)
class HeldOutScores:
    """Scores of runs by detectors that were not fitted on their block; of shape (n_runs,)."""

    score: NDArray[np.float64]  # standardised by the calibration scores
    p: NDArray[np.float64]  # conformal p-values; NaN where unsupported
    calibration: int  # fewest calibration runs of any p-value


def held_out(
    runs: MeasuredRuns, columns: Sequence[str], detector: Detector, folds: Sequence[Fold]
) -> HeldOutScores:
    """Score every run by its features, by a detector fitted on normal runs of other blocks.

    Parameters
    ----------
    runs : Runs
    columns : sequence of str
        Features to use.
    detector : Detector
        Unfitted; it is cloned.
    folds : sequence of Fold
        Over the runs.

    Raises
    ------
    DetectorError
        The detector cannot be fitted on this number of runs or features.
    """
    scores = standardised(fold_scores(runs.features, columns, detector, folds), folds)
    return HeldOutScores(
        of_tested(scores, folds), conformal(scores, folds), calibration_runs(folds)
    )


def calibration_runs(folds: Sequence[Fold]) -> int:
    """Return the smallest number of calibration runs of any fold."""
    return min((int(fold.calibrate.sum()) for fold in folds), default=0)


def fold_scores(
    table: pd.DataFrame, columns: Sequence[str], detector: Detector, folds: Sequence[Fold]
) -> NDArray[np.float64]:
    """Fit and score in every fold; shape (n_folds, n_rows).

    A fold with fewer than two rows to fit on, or without a finite value in them, is NaN.
    """
    X, floors = table[list(columns)], feature_floors(table)
    scores = np.full((len(folds), len(table)), np.nan)
    for number, fold in enumerate(folds):
        if fold.fit.sum() > 1 and np.isfinite(X[fold.fit].to_numpy()).any():
            model = pipeline(clone(detector), floors).fit(X[fold.fit])
            scored = fold.calibrate | fold.test
            scores[number, scored] = -model.score_samples(X[scored])
    return scores


def standardised(scores: NDArray[np.float64], folds: Sequence[Fold]) -> NDArray[np.float64]:
    """Standardise the scores of each fold by median and MAD of its calibration scores.

    This keeps the order within a fold. If the MAD is 0, only the median is subtracted.
    """
    scaled = np.empty_like(scores)
    for number, fold in enumerate(folds):
        calibration = _finite(scores[number, fold.calibrate])
        if not len(calibration):
            scaled[number] = np.nan
            continue
        centre = np.median(calibration)
        spread = MAD_TO_DEVIATION * np.median(np.abs(calibration - centre))
        scaled[number] = (scores[number] - centre) / (spread if spread > 0.0 else 1.0)
    return scaled


def of_tested(scores: NDArray[np.float64], folds: Sequence[Fold]) -> NDArray[np.float64]:
    """Return the score of each row in the fold that tests it; NaN if no fold does."""
    tested = np.full(scores.shape[1:], np.nan)
    for number, fold in enumerate(folds):
        tested[fold.test] = scores[number, fold.test]
    return tested


def conformal(scores: NDArray[np.float64], folds: Sequence[Fold]) -> NDArray[np.float64]:
    """Return each run's p-value among the calibration runs of the fold that tests it."""
    p = np.full(scores.shape[1:], np.nan)
    for number, fold in enumerate(folds):
        tested = fold.test & np.isfinite(scores[number])
        calibration = _finite(scores[number, fold.calibrate])
        p[tested] = p_values(calibration, scores[number, tested])
    return p


def _finite(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    return scores[np.isfinite(scores)]
