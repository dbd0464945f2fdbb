"""Tampering and misbehaviour: two ground truths of a run, each compared with its own score.

A run is *tampered* if an attack altered messages, and *misbehaved* if the robot acted differently
from unaltered runs of its block (``oracle_pipeline.evaluation.task_effects``). Each ground truth is
compared with the score of the same name on the reference card.

Most runs that misbehaved were attacked, so a score that only shows the attack would seem to show
the misbehaviour, too. Within a mode, runs differ by their effect alone. Only calm blocks count
there: where unaltered runs are unusual, a run without an effect is so as well.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.evaluation.comparisons import ComparedRuns, judge, runs_of
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc
from oracle_pipeline.evaluation.task_effects import TaskEffects

Row = dict[str, float | int | str]


def aspects_table(
    scores: Mapping[str, HeldOutScores],
    campaign: JudgedRuns,
    effects: TaskEffects,
    compared: Sequence[ComparedRuns],
    rng: np.random.Generator,
) -> pd.DataFrame:
    """Return a row for each aspect and comparison, with the metrics of `judge`.

    Parameters
    ----------
    scores : mapping of str to HeldOutScores
        By aspect: ``tampering``, ``misbehaviour``.
    campaign : JudgedRuns
    effects : TaskEffects
    compared : sequence of ComparedRuns
    rng : Generator
        Draws the resamples for the intervals.
    """
    truth = {
        "tampering": (campaign.malicious, np.ones_like(campaign.malicious)),
        "misbehaviour": (effects.misbehaved, effects.known),
    }
    rows: list[Row] = []
    for aspect, of_aspect in scores.items():
        positive, known = truth[aspect]
        for each in compared:
            scope = ComparedRuns(each.name, each.runs & known)
            if scope.runs.any():
                figures = judge(of_aspect, campaign, scope, rng, positive)
                calm = ComparedRuns(each.name, scope.runs & effects.calm)
                figures |= _within_modes(of_aspect, campaign, calm, rng, positive)
                rows.append({"aspect": aspect, "scope": each.name, **figures})
    return pd.DataFrame(rows)


def _within_modes(
    scores: HeldOutScores,
    campaign: JudgedRuns,
    scope: ComparedRuns,
    rng: np.random.Generator,
    positive: NDArray[np.bool_],
) -> dict[str, float]:
    """Return the AUC over the pairs of runs of the same mode."""
    runs = runs_of(campaign, scope.runs, positive)
    mode = campaign.features["mode"].to_numpy(dtype=str)[runs.first]
    return auc(scores.score[runs.first], runs, rng, within=mode).columns("auc_within_modes")
