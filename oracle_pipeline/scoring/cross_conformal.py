"""Cross-conformal p-values: each normal run calibrates a model that did not see it.

The normal runs are split into folds by session. For each fold a scorer is fitted on the other folds
and scores this one. A new run is scored by every scorer, and is compared with each normal run under
the scorer that was not fitted on it (cross-conformal prediction [1]_; CV+ in regression [2]_).
Splitting into a fitting and a calibrating half instead would need twice the recordings for the same
smallest p-value.

If the new run is exchangeable with the normal ones, ``p <= alpha`` has a probability of at most ``2
alpha`` for any scorer, and of about ``alpha`` for scorers that hardly change when one fold is left
out [2]_. The evaluation measures the realised rate.

Runs of one session share nuisance parameters, so no scorer calibrates on a session that it was
fitted on. With fewer than three sessions, the split is by block. Runs of one block share start and
goals too, so a block has one vote.

References
----------
.. [1] V. Vovk, "Cross-conformal predictors", Annals of Mathematics and Artificial Intelligence 74,
   2015.
.. [2] R. F. Barber, E. J. Candès, A. Ramdas, R. J. Tibshirani, "Predictive inference with the
   jackknife+", Annals of Statistics 49, 2021.
"""

from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.terminal import count_of
from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.scoring import run_scorer
from oracle_pipeline.scoring.alarms import NormalWindows
from oracle_pipeline.scoring.conformal import ConformalError
from oracle_pipeline.scoring.lengths import is_outside
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

FOLDS = 10  # at most; never more than there are sessions, or blocks if split by block
SEED = 0  # of the folds, and of detectors that draw
MIN_BLOCKS = 3  # two to fit on, one to hold out
WELL_KNOWN = 100  # features beside which signals count half; beside twice as many, a ninth
FOR_DIRECTION = 4  # sessions or blocks for each direction that `LargestGroup` keeps
_ROUNDING = 1e-9  # spread of scores up to which they count as equal [scales]


class CrossConformalScorer:
    """Scores and p-values of runs, learned from normal ones.

    Parameters
    ----------
    design : Design
        The features and the detector.

    Attributes
    ----------
    scorers_ : list of RunScorer
        One for each fold, fitted on all other folds.
    fold_ : ndarray of int, shape (n_runs,)
        Fold in which each normal run was held out.
    block_ : ndarray of int, shape (n_runs,)
        Block of each normal run.
    levels_ : tuple of str
        Levels of the score, `RunScorer.levels`.
    centre_, spread_ : ndarray of shape (n_levels,)
        They bring the levels to one scale: by scaled MAD or standard deviation of the held-out
        scores, whichever is larger, so that a level with a few far normal runs hides no other. The
        largest level of normal runs then has median 0, and deviation 1 by its upper quartile; its
        MAD may be next to 0, as many runs are within all ranges. The more features know the robot,
        the less signals count: they show every difference, also that of a harmless obstacle.
    held_out_ : ndarray of shape (n_runs,)
        Score of each normal run by the scorer that was not fitted on it.
    windows_ : NormalWindows or None
        Held-out scores of their windows for alarms; None if windows have no features.
    """

    def __init__(self, design: run_scorer.Design) -> None:
        self.design = design

    def fit(self, runs: MeasuredRuns, rng: np.random.Generator) -> Self:
        """Learn from normal runs.

        Parameters
        ----------
        runs : MeasuredRuns
            Normal runs only.
        rng : Generator
            Assigns the sessions to folds.

        Raises
        ------
        ConformalError
            Fewer than three blocks.
        DetectorError
            The detector cannot be fitted on so few runs.
        """
        seen = runs.with_columns(self.design.run_columns, self.design.window_columns)
        self.block_ = runs.block
        unit = _split_unit(runs)
        self.fold_ = assign_folds(unit, FOLDS, rng)
        directions = len(np.unique(unit)) // FOR_DIRECTION
        self.scorers_ = []
        by_level: NDArray[np.float64] | None = None
        of_windows = np.empty(len(runs.run))
        for fold in range(self.fold_.max() + 1):
            out = self.fold_ == fold
            held_out = seen.where(out)
            scorer = run_scorer.RunScorer(self.design, directions).fit(seen.where(~out))
            scores = scorer.score(held_out)
            if by_level is None:
                by_level = np.empty((len(out), scores.shape[1]))
            by_level[out] = scores
            if self.design.window_features:
                of_windows[out[runs.run]] = scorer.alarm_scores(held_out.windows)
            self.scorers_.append(scorer)
        assert by_level is not None  # noqa: S101 -- there are at least three folds
        self.levels_ = self.scorers_[0].levels
        self.centre_ = np.median(by_level, axis=0)
        mad = MAD_TO_DEVIATION * np.median(np.abs(by_level - self.centre_), axis=0)
        self.spread_ = np.maximum(mad, by_level.std(axis=0))
        self.spread_[self.spread_ < _ROUNDING] = 1.0
        if self.design.uses_features:
            known = (len(self.design.run_features) / WELL_KNOWN) ** 3
            self.spread_[np.isin(self.levels_, run_scorer.OF_SIGNALS)] *= 1.0 + known
        centre, quartile = np.quantile(self._combined(by_level), (0.5, 0.75))
        above = MAD_TO_DEVIATION * (quartile - centre)
        self.centre_ = self.centre_ + centre * self.spread_
        self.spread_ = self.spread_ * (above if above > _ROUNDING else 1.0)
        self.held_out_ = self._combined(by_level)
        self.windows_ = None
        if self.design.window_features:
            self.windows_ = NormalWindows(of_windows, runs.start_s, runs.run, runs.block)
        return self

    def scores(self, runs: MeasuredRuns) -> NDArray[np.float64]:
        """Return each run's score by each fold's scorer, shape (n_folds, n_runs).

        The unit is the spread of held-out normal runs; 0 is their median. Higher is more anomalous.
        """
        seen = runs.with_columns(self.design.run_columns, self.design.window_columns)
        weight = self._weights(runs.counts)
        return np.stack([self._combined(scorer.score(seen), weight) for scorer in self.scorers_])

    def p_values(
        self, scores: NDArray[np.float64], block: NDArray[np.int64] | None = None
    ) -> NDArray[np.float64]:
        """Return the share of blocks that score at least as high, counting the new run as one.

        Parameters
        ----------
        scores : ndarray of shape (n_folds, n_runs)
            From `scores`.
        block : ndarray of int, shape (n_runs,), optional
            Block of each run. For a block that was learned from, only the scorer that was not
            fitted on it is used, and the block has no vote.

        Returns
        -------
        ndarray of shape (n_runs,)
            In ``[1 / (n + 1), 1]``, where n blocks vote.
        """
        if not np.isfinite(scores).all():
            raise ConformalError(
                "A score is not a finite number, so it cannot be ranked; look for a feature that "
                "has no finite value in the normal recordings."
            )
        names, number, size = np.unique(self.block_, return_inverse=True, return_counts=True)
        p = np.empty(scores.shape[1])
        for run, own in enumerate(scores.T):
            against, voters = own[self.fold_], np.ones(len(names), dtype=np.bool_)
            if block is not None and block[run] in names:
                voters[names == block[run]] = False
                against = np.full(len(self.fold_), own[self.fold_[self.block_ == block[run]][0]])
            votes = np.bincount(number, self.held_out_ >= against, len(names)) / size
            p[run] = (1.0 + votes[voters].sum()) / (voters.sum() + 1.0)
        return p

    def own_score(
        self, scores: NDArray[np.float64], block: NDArray[np.int64] | None = None
    ) -> NDArray[np.float64]:
        """Return one score for each run, shape (n_runs,).

        Parameters
        ----------
        scores, block
            As for `p_values`.

        Returns
        -------
        ndarray of shape (n_runs,)
            The median over the folds; for a run of a known block, the score of the scorer that was
            not fitted on it.
        """
        own = np.asarray(np.median(scores, axis=0), dtype=np.float64)
        if block is not None:
            names, first = np.unique(self.block_, return_index=True)
            place = np.minimum(np.searchsorted(names, block), len(names) - 1)
            (known,) = np.nonzero(names[place] == block)
            own[known] = scores[self.fold_[first[place[known]]], known]
        return own

    def window_scores(
        self, windows: pd.DataFrame, block: NDArray[np.int64] | None = None
    ) -> NDArray[np.float64]:
        """Return one score for alarms for each window, shape (n_windows,), as `AlarmWatch` needs.

        Windows are scored independently, so those of a running robot can be scored one by one.

        Parameters
        ----------
        windows : DataFrame
            One row per window; absent columns count as missing values.
        block : ndarray of int, shape (n_windows,), optional
            As for `p_values`, but of each window.
        """
        known = windows.reindex(columns=self.design.window_columns)
        of_folds = np.stack([scorer.alarm_scores(known) for scorer in self.scorers_])
        return self.own_score(of_folds, block)

    def window_families(self, windows: pd.DataFrame) -> list[list[str]]:
        """Return the unusual families of each window, the farthest first, as `AlarmWatch` needs."""
        known = windows.reindex(columns=self.design.window_columns)
        return self.scorers_[0].unusual_families(known)

    @property
    def lengths(self) -> tuple[int, int] | None:
        """Fewest and most windows of a normal recording; None if windows have no features."""
        if self.windows_ is None:
            return None
        counts = np.bincount(self.windows_.run, minlength=len(self.windows_.block))
        return int(counts.min()), int(counts.max())

    def _weights(self, counts: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return what each level counts for recordings of so many windows, (n_runs, n_levels).

        A mean over a short recording scatters more, by the root of its length. Signals depend on
        the way, so their statistics over a shorter or longer one do not count beside others.
        """
        weights = np.ones((len(counts), len(self.levels_)))
        if self.lengths is None:
            return weights
        of_whole = np.array([level not in run_scorer.OF_WINDOWS for level in self.levels_])
        weights[:, of_whole] = np.sqrt(np.minimum(counts / self.lengths[0], 1.0))[:, np.newaxis]
        reaching = np.array([level in run_scorer.WHOLE_SIGNALS for level in self.levels_])
        if not reaching.all():
            weights[np.ix_(is_outside(counts, self.lengths), reaching)] = 0.0
        return weights

    def _combined(
        self, by_level: NDArray[np.float64], weight: NDArray[np.float64] | float = 1.0
    ) -> NDArray[np.float64]:
        """Return the largest standardised level of each run, shape (n_runs,)."""
        standard = (by_level - self.centre_) / self.spread_
        return np.asarray((weight * standard).max(axis=1), dtype=np.float64)


def _split_unit(runs: MeasuredRuns) -> NDArray[np.int64]:
    """Return the session of each run, or its block if there are too few sessions."""
    sessions, of_block = np.unique(runs.session), np.unique(runs.block)
    pairs = np.unique(np.column_stack([runs.block, runs.session]), axis=0)
    is_nested = len(pairs) == len(of_block)  # false if tables of two campaigns were joined
    return runs.session if len(sessions) >= MIN_BLOCKS and is_nested else runs.block


def assign_folds(unit: NDArray[np.int64], folds: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Assign whole sessions or blocks to folds of nearly equal size, shape (n_runs,)."""
    names, number = np.unique(unit, return_inverse=True)
    if len(names) < MIN_BLOCKS:
        raise ConformalError(
            f"The normal recordings count as {count_of(len(names), 'block')}; learning needs at "
            f"least {MIN_BLOCKS}. Record normal runs with other starts, goals or days."
        )
    fold = rng.permutation(len(names)) % min(folds, len(names))
    return np.asarray(fold[number], dtype=np.intp)
