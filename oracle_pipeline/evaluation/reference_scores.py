"""Scores by the scorer of a reference card, as in ``oracle score``.

It is learned once from all normal runs, and judges each run by the model that was not fitted on the
run's block (``oracle_pipeline.scoring.cross_conformal``). For splits that hold out more than a
block, a new scorer is learned from the training runs of each fold.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.splits import Fold
from oracle_pipeline.scoring.conformal import ConformalError
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.learning import learned_scorer
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.verdict import ScoringError


def reference_scores(
    runs: MeasuredRuns, folds: Sequence[Fold] | None = None, features: str = "all"
) -> HeldOutScores:
    """Score runs by a reference learned from normal runs of other blocks.

    Parameters
    ----------
    runs : MeasuredRuns
    folds : sequence of Fold, optional
        In each fold, a scorer learned from its fitting and calibration runs scores the tested runs.
        By default one scorer is learned from all normal runs.
    features : str
        Name of the scorer's set of features: ``all``, or an aspect of the card.

    Returns
    -------
    HeldOutScores
        NaN if there are too few blocks to learn from; ``calibration`` counts blocks.

    Raises
    ------
    DetectorError
        The detector cannot be fitted on so few runs.
    """
    if folds is None:
        return scored(runs, reference_of(runs, ~runs.malicious, features))
    score, p = np.full((2, len(runs.features)), np.nan)
    blocks = []
    for fold in folds:
        scorer = reference_of(runs, fold.fit | fold.calibrate, features)
        if scorer is not None:
            of_fold = scored(runs.where(fold.test), scorer)
            score[fold.test], p[fold.test] = of_fold.score, of_fold.p
            blocks.append(of_fold.calibration)
    return HeldOutScores(score, p, min(blocks, default=0))


def reference_of(
    runs: MeasuredRuns, normal: NDArray[np.bool_], features: str = "all"
) -> CrossConformalScorer | None:
    """Return the scorer learned from some runs; None if there are too few or they have no feature.

    Parameters
    ----------
    runs : MeasuredRuns
    normal : ndarray of bool, shape (n_runs,)
        The runs to learn from.
    features : str
        As for `reference_scores`.
    """
    try:
        return learned_scorer(runs.where(normal), features)
    except (ConformalError, ScoringError):  # the row of the table has a note on it
        return None


def scored(runs: MeasuredRuns, scorer: CrossConformalScorer | None) -> HeldOutScores:
    """Return the scores of runs, each by the model that was not fitted on the run's block."""
    if scorer is None:
        unknown = np.full(len(runs.features), np.nan)
        return HeldOutScores(unknown, unknown, 0)
    of_folds = scorer.scores(runs)
    return HeldOutScores(
        scorer.own_score(of_folds, runs.block),
        scorer.p_values(of_folds, runs.block),
        _votes(scorer.block_, runs.block),
    )


def _votes(learned: NDArray[np.int64], tested: NDArray[np.int64]) -> int:
    """Return the smallest number of blocks that vote on a tested run."""
    blocks = len(np.unique(learned))
    return blocks - 1 if np.isin(tested, learned).any() else blocks
