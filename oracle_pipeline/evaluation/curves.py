"""The ROC curves of the headline's scorer."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from oracle_pipeline.evaluation.comparisons import OBSTACLE, ComparedRuns, runs_of
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import RocCurve, auc, roc_curve

NamedCurves: TypeAlias = Mapping[str, tuple[RocCurve, Estimate]]  # each with its AUC


def roc_curves(
    scores: HeldOutScores,
    campaign: JudgedRuns,
    compared: Sequence[ComparedRuns],
    rng: np.random.Generator,
) -> NamedCurves:
    """Return the curves of a scorer by comparison; none where one class of runs has no scores.

    Parameters
    ----------
    scores : HeldOutScores
    campaign : JudgedRuns
    compared : sequence of ComparedRuns
        From `comparisons.comparisons`, all modes first.
    rng : Generator
        Draws the resamples behind the bands.
    """
    curves = {}
    for each in _shown(compared):
        scored = each.runs & np.isfinite(scores.score)
        if len(np.unique(campaign.malicious[scored])) == 2:
            runs = runs_of(campaign, each.runs)
            score = scores.score[runs.first]
            curves[each.name] = (roc_curve(score, runs, rng), auc(score, runs, rng))
    return curves


def _shown(compared: Sequence[ComparedRuns]) -> list[ComparedRuns]:
    """Return the comparison of all modes, and of each attack with its shadow or else control."""
    all_modes, *others = compared
    pairs = [each for each in others if "/" in each.name]
    against_normal = [each for each in pairs if each.name != " / ".join(OBSTACLE)]
    return [all_modes, *{each.name.split(" / ")[1]: each for each in against_normal}.values()]
