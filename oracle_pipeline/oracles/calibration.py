"""P-values for any kind of oracle, with the folds and votes of a reference card's scorer.

For each fold a kind learns from the normal runs of the other sessions and scores all runs. A run is
compared with each normal run by the model that was not fitted on the normal run's fold nor, for a
run of a known block, on its own fold (``oracle_pipeline.scoring.cross_conformal``).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.detectors.distances import LargestZ
from oracle_pipeline.oracles.kind import OracleKind, TracedRuns
from oracle_pipeline.scoring import cross_conformal
from oracle_pipeline.scoring.run_scorer import Design

_SEED = 0
_TAIL = 0.95  # quantile of normal scores that defines the unit
_FAR = 1e6  # limit of a score, in these units


@dataclass(frozen=True, eq=False, slots=True)
class KindScores:
    """Scores and p-values of runs by one oracle; arrays of shape (n_runs,)."""

    score: NDArray[np.float64]
    p: NDArray[np.float64]


def calibrated(kind: OracleKind, runs: TracedRuns) -> KindScores:
    """Judge all runs by a kind that is fitted on the normal ones.

    Raises
    ------
    ConformalError
        Fewer than three blocks of normal runs.
    """
    return _judge_by_votes(_fold_scores(kind, runs), runs)


def union(verdicts: Sequence[KindScores], runs: TracedRuns) -> KindScores:
    """Judge runs by several oracles at once, at the false positive rate of one.

    The minimum of several p-values is not a p-value: it decreases with the number of oracles by
    chance. So each run's largest score, in units of the spread of normal runs, is compared with
    that of normal runs (maxT of Westfall and Young). Combining p-values would give ties, because
    with few blocks most runs share the smallest one.
    """
    normal = runs.normal
    units = [_in_tail_units(each.score, each.score[normal]) for each in verdicts]
    fold = _folds(runs.where(normal))
    return _judge_by_votes(np.tile(np.max(units, axis=0), (fold.max() + 1, 1)), runs)


def _in_tail_units(score: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return scores relative to the median of normal runs, in units of their upper tail.

    If all normal runs have the same score, any higher score is extreme.
    """
    median, tail, highest = np.quantile(normal, [0.5, _TAIL, 1.0])
    reach = max(tail - median, 0.1 * (highest - median))
    units = (score - median) / (reach if reach > 0.0 else 1.0 / _FAR)
    return np.asarray(np.clip(units, -_FAR, _FAR), dtype=np.float64)


def _fold_scores(kind: OracleKind, runs: TracedRuns) -> NDArray[np.float64]:
    """Return the scores of all runs by the model of each fold, shape (n_folds, n_runs)."""
    normal = runs.normal
    rows, fold = np.flatnonzero(normal), _folds(runs.where(normal))
    scores: list[NDArray[np.float64]] = []
    for number in range(fold.max() + 1):
        seen = np.zeros(len(normal), dtype=np.bool_)
        seen[rows[fold != number]] = True
        judge = kind.learn(runs.where(seen))
        if id(judge) == id(kind) and scores:  # nothing to fit, so the scores are the same
            scores.append(scores[0])
        else:
            scores.append(judge.score(runs))
    return np.stack(scores)


def _folds(normal: TracedRuns) -> NDArray[np.intp]:
    """Assign whole sessions to folds, or blocks if there are too few, as a reference card does."""
    few = len(np.unique(normal.session)) < cross_conformal.MIN_BLOCKS
    unit = normal.block if few else normal.session
    return cross_conformal.assign_folds(unit, cross_conformal.FOLDS, np.random.default_rng(_SEED))


def _judge_by_votes(scores: NDArray[np.float64], runs: TracedRuns) -> KindScores:
    """Compute p-values from the votes of normal blocks; `scores` has shape (n_folds, n_runs)."""
    normal = runs.normal
    # Only for its folds and votes.
    votes = cross_conformal.CrossConformalScorer(Design(LargestZ(), (), (), {}))
    votes.fold_, votes.block_ = _folds(runs.where(normal)), runs.block[normal]
    votes.held_out_ = scores[votes.fold_, np.flatnonzero(normal)]
    return KindScores(votes.own_score(scores, runs.block), votes.p_values(scores, runs.block))
