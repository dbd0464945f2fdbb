"""Scores of runs by detectors that were not fitted on their block, calibrated to one scale.

In every fold (`splits`) a new detector is fitted, and scores the calibration and test rows. Higher
scores are more anomalous. Arrays of scores have one row per fold, with NaN for runs that are
neither calibration nor test rows of the fold.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import clone

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.datasets import feature_columns, feature_floors, is_malicious
from oracle_pipeline.detectors import Detector, pipeline
from oracle_pipeline.evaluation.splits import Fold
from oracle_pipeline.scoring import run_scorer
from oracle_pipeline.scoring.conformal import p_values
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import common_length

Level = Literal["run", "windows", "both"]


@dataclass(frozen=True, eq=False, slots=True)
class HeldOutScores:
    """Scores of runs by detectors that were not fitted on their block; of shape (n_runs,)."""

    score: NDArray[np.float64]  # standardised by the calibration scores
    p: NDArray[np.float64]  # conformal p-values; NaN where unsupported
    calibration: int  # fewest calibration runs of any p-value


def held_out(
    runs: MeasuredRuns,
    columns: Sequence[str],
    detector: Detector,
    folds: Sequence[Fold],
    level: Level = "run",
) -> HeldOutScores:
    """Score every run by a detector fitted on normal runs of other blocks.

    Parameters
    ----------
    runs : Runs
    columns : sequence of str
        Features to use; windows may lack some of them.
    detector : Detector
        Unfitted; it is cloned.
    folds : sequence of Fold
        Over the runs.
    level : {"run", "windows", "both"}
        Score by the features of the run, by those of its most unusual windows (`top_windows`), or
        by the larger of the two standardised scores.

    Raises
    ------
    DetectorError
        The detector cannot be fitted on this number of runs or features.
    """
    scores = []
    if level in ("run", "both"):
        scores.append(fold_scores(runs.features, columns, detector, folds))
    if level in ("windows", "both"):
        of_windows = window_scores(runs, columns, detector, folds)
        scores.append(top_windows(of_windows, runs, folds))
    furthest = np.max([standardised(part, folds) for part in scores], axis=0)
    p = conformal(furthest, folds)
    return HeldOutScores(of_tested(furthest, folds), p, calibration_runs(folds))


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


def window_scores(
    runs: MeasuredRuns, columns: Sequence[str], detector: Detector, folds: Sequence[Fold]
) -> NDArray[np.float64]:
    """Score windows by a detector fitted on windows of normal runs; (n_folds, n_windows)."""
    present = set(feature_columns(runs.windows))
    windowed = [column for column in columns if column in present]
    of_windows = [fold.of(runs.run) for fold in folds]
    return fold_scores(runs.windows, windowed, detector, of_windows)


def top_windows(
    scores: NDArray[np.float64], runs: MeasuredRuns, folds: Sequence[Fold]
) -> NDArray[np.float64]:
    """Return the mean score of each run's three most unusual windows, shape (n_folds, n_runs).

    A longer run has more extreme windows by chance, and attacked runs are longer. So windows count
    only up to the length that nine tenths of the fitted runs reach.
    """
    counts = runs.counts
    top = np.empty((len(folds), len(counts)))
    for number, fold in enumerate(folds):
        counted = common_length(counts[fold.fit])
        top[number] = run_scorer.top_windows(scores[number], runs, counted)
    return top


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


def supervised_scores(
    features: pd.DataFrame,
    columns: Sequence[str],
    classifier: Any,
    folds: Sequence[Fold],
    target: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Return the scores of a classifier that was trained with the labels of other blocks.

    It is not an oracle but an upper bound for these features.

    Parameters
    ----------
    features : DataFrame
        One row for each run.
    columns : sequence of str
    classifier : scikit-learn classifier
        Unfitted.
    folds : sequence of Fold
    target : ndarray of bool, shape (n_runs,), optional
        What to predict; by default whether a run was attacked.

    Returns
    -------
    ndarray of shape (n_runs,)
        Probability; NaN where the training rows have one class only.
    """
    target = is_malicious(features) if target is None else target
    X, floors = features[list(columns)], feature_floors(features)
    scores = np.full(len(features), np.nan)
    for fold in folds:
        if np.unique(target[fold.train]).size == 2 and np.isfinite(X[fold.train].to_numpy()).any():
            model = pipeline(clone(classifier), floors).fit(X[fold.train], target[fold.train])
            scores[fold.test] = model.predict_proba(X[fold.test])[:, 1]
    return scores
