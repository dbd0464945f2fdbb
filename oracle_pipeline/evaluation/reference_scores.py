"""Scores by the same scorer that users call: that of a reference card.

Learned once from all normal runs, it judges each run by the model that did not see the run's block
(``oracle_pipeline.scoring.cross_conformal``), as ``oracle score`` does for a run of a campaign. For
splits that hold more out than a block, it is learned anew from what each fold may see.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.splits import Fold
from oracle_pipeline.scoring.conformal import ConformalError
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
        In each, the tested runs are scored by a reference learned from the normal runs that fit and
        calibrate. By default there is one reference, learned from all normal runs.
    features : str
        Name of the scorer's set of features: ``all``, or an aspect of the card.

    Returns
    -------
    HeldOutScores
        NaN where there are too few blocks to learn from; ``calibration`` counts blocks.

    Raises
    ------
    DetectorError
        The detector cannot be fitted on so few runs.
    """
    everything = np.ones(len(runs.features), dtype=np.bool_)
    rounds = [(~runs.malicious, everything)]
    if folds is not None:
        rounds = [(fold.fit | fold.calibrate, fold.test) for fold in folds]
    score, p = np.full((2, len(runs.features)), np.nan)
    blocks = []
    for normal, tested in rounds:
        try:
            scorer = learned_scorer(runs.where(normal), features)
        except (ConformalError, ScoringError):  # too few blocks or no feature: the row says so
            continue
        of_folds, own_block = scorer.scores(runs.where(tested)), runs.block[tested]
        score[tested] = scorer.own_score(of_folds, own_block)
        p[tested] = scorer.p_values(of_folds, own_block)
        blocks.append(_votes(scorer.block_, own_block))
    return HeldOutScores(score, p, min(blocks, default=0))


def _votes(learned: NDArray[np.int64], tested: NDArray[np.int64]) -> int:
    """Return how many blocks vote on a tested run, at least."""
    blocks = len(np.unique(learned))
    return blocks - 1 if np.isin(tested, learned).any() else blocks
