"""Verdicts on the runs of a campaign as users get them, by cards that do not know their blocks.

In each fold, `learn` makes a card of normal runs as ``oracle learn`` does, and `judge_all` gives
every tested run the verdict of ``oracle score``, contract included. A card has seen neither the
block nor, if there are enough of them, the session of a run that it judges. So no tested run is
among those that set its threshold.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.detectors import single_threaded
from oracle_pipeline.evaluation import splits
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.conformal import ConformalError, runs_needed
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.judging import Recording, judge_all
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.output import EXIT_CODES
from oracle_pipeline.scoring.reference import Reference
from oracle_pipeline.scoring.verdict import AspectScore, ScoringError, Verdict

RATE = 0.05  # nominal false positive rate of all verdicts

Observations = Mapping[str, Observation]  # by run
Judged: TypeAlias = Sequence[Verdict | None]
#: Calls a function for each fold, as ``map`` does, perhaps in other processes.
Each: TypeAlias = Callable[[Callable[[int], Judged], Sequence[int]], Iterable[Judged]]


@dataclass(frozen=True, eq=False, slots=True)
class CardVerdicts:
    """The verdict on each run; None for a run that no card judged."""

    verdicts: tuple[Verdict | None, ...]

    def scores(self, aspect: str = "") -> HeldOutScores:
        """Return scores and p-values of the headline, or of an aspect of the card."""
        found = [_numbers(verdict, aspect) for verdict in self.verdicts]
        p, score = np.array(found, dtype=np.float64).reshape(-1, 2).T
        blocks = [verdict.normal_blocks for verdict in self.verdicts if verdict is not None]
        return HeldOutScores(score, p, min(blocks, default=0))

    def exits(self) -> NDArray[np.float64]:
        """Return 1 for each run with exit code 1, else 0; NaN where no verdict is supported."""
        return np.array(
            [
                np.nan
                if verdict is None or verdict.outcome == "unsupported"
                else EXIT_CODES[verdict.outcome] == 1
                for verdict in self.verdicts
            ],
            dtype=np.float64,
        )


def _numbers(verdict: Verdict | None, aspect: str) -> tuple[float | None, float | None]:
    of: Verdict | AspectScore | None = verdict
    if verdict is not None and aspect:
        of = verdict.aspects.get(aspect)
    return (np.nan, np.nan) if of is None else (of.p_value, of.score)


def blocks_for_verdicts() -> int:
    """Return how many blocks leave enough for a verdict when a fifth of them is held out."""
    return next(n for n in count(1) if n - -(-n // splits.FOLDS) >= runs_needed(RATE))


def card_folds(df: pd.DataFrame, seed: int) -> list[splits.Fold]:
    """Return the folds of the cards: whole sessions are held out if there are five, else blocks.

    A campaign of a few blocks has one fold: a single card judges all runs, each by the models that
    left its block out.
    """
    by_session = df["session"].nunique() >= splits.FOLDS
    folds = (
        splits.group_folds(df, splits.SESSION, seed) if by_session else splits.block_folds(df, seed)
    )
    block = df["block"].to_numpy()
    known = [len(np.unique(block[fold.fit | fold.calibrate])) for fold in folds]
    return folds if min(known, default=0) >= splits.MIN_BLOCKS else splits.within_one_card(df)


def card_verdicts(
    runs: MeasuredRuns,
    folds: Sequence[splits.Fold],
    observations: Observations | None = None,
    each: Each = map,
) -> CardVerdicts:
    """Judge the tested runs of each fold by a card of its other normal runs.

    Parameters
    ----------
    runs : MeasuredRuns
    folds : sequence of Fold
        Cards are learned from the rows to fit and to calibrate.
    observations : mapping of str to Observation, optional
        Interfaces of the runs. Cards have a contract if all runs that they learn from are in it.
    each : callable
        Judges the folds, in order.
    """
    verdicts: list[Verdict | None] = [None] * len(runs.features)
    judge = partial(_judged, runs, folds, observations or {})
    for fold, judged in zip(folds, each(judge, range(len(folds))), strict=True):
        for row, verdict in zip(np.flatnonzero(fold.test).tolist(), judged, strict=True):
            verdicts[row] = verdict or verdicts[row]
    return CardVerdicts(tuple(verdicts))


def _judged(
    runs: MeasuredRuns, folds: Sequence[splits.Fold], seen: Observations, number: int
) -> Judged:
    """Return the verdicts on the tested runs of a fold."""
    fold = folds[number]
    tested = np.flatnonzero(fold.test).tolist()
    with single_threaded():
        card = _card(runs, fold.fit | fold.calibrate, seen)
        if card is None:
            return [None] * len(tested)
        return judge_all([_recording(runs, row, seen) for row in tested], card, RATE)


def _recording(runs: MeasuredRuns, row: int, seen: Observations) -> Recording:
    """Return a run of the tables."""
    name = str(runs.features["run_id"].iloc[row])
    tables = FeatureTables(runs.features.iloc[[row]], runs.windows[runs.run == row])
    return Recording(name, tables, seen.get(name))


def _card(
    runs: MeasuredRuns, normal: NDArray[np.bool_], seen: Observations
) -> ReferenceCard | None:
    """Return a card of some runs; None if there are too few, or they have no feature."""
    known = runs.where(normal)
    of_known = [seen[run] for run in known.features["run_id"] if run in seen]
    complete = tuple(of_known) if len(of_known) == len(known.features) else ()
    try:
        return learn(Reference(known.features, known.windows, complete))
    except (ConformalError, ScoringError):  # the note of the table's row says so
        return None
