"""Tampering and misbehaviour: two ground truths of a run, each compared with its own score.

A run is *tampered* if an attack altered messages, and *misbehaved* if the robot acted differently
from unaltered runs of its block (``oracle_pipeline.evaluation.task_effects``). Each ground truth is
compared with the score of the same name on the reference card.

Most runs that misbehaved were attacked, so a score that only shows the attack would seem to show
the misbehaviour, too. Within a mode, runs differ by their effect alone.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.comparisons import HARD_NEGATIVES, ComparedRuns, judge, runs_of
from oracle_pipeline.evaluation.estimate import NOTHING
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, share
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
                figures |= _within_modes(of_aspect, campaign, scope, rng, positive)
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


def aspects_by_mode(
    scores: Mapping[str, HeldOutScores],
    campaign: JudgedRuns,
    effects: TaskEffects,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """Return a row for each mode: which runs misbehaved, their AUC, and the verdicts.

    The last row is for all hard negatives, if there are any.

    Parameters
    ----------
    scores : mapping of str to HeldOutScores
        By aspect.
    campaign : JudgedRuns
    effects : TaskEffects
    rng : Generator
        Draws the resamples for the intervals.
    """
    mode, harmless = campaign.features["mode"].to_numpy(), is_hard_negative(campaign.features)
    named = {name: mode == name for name in dict.fromkeys(campaign.features["mode"])}
    if harmless.any():
        named[HARD_NEGATIVES] = harmless
    rows = []
    for name, members in named.items():
        compared = members & effects.known
        sizes = effects.size[compared]
        rows.append(
            {
                "mode": name,
                "runs": int(compared.sum()),
                **share(effects.misbehaved[compared], campaign.block[compared], rng).columns(
                    "misbehaved"
                ),
                "effect_median": float(np.median(sizes)) if len(sizes) else np.nan,
                **_area(scores, campaign, compared, effects, rng),
                **_called(scores, campaign, members, rng),
            }
        )
    return pd.DataFrame(rows)


def _area(
    scores: Mapping[str, HeldOutScores],
    campaign: JudgedRuns,
    members: NDArray[np.bool_],
    effects: TaskEffects,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Return the AUC of misbehaviour among the runs of one mode."""
    if "misbehaviour" not in scores:
        return NOTHING.columns("auc")
    runs = runs_of(campaign, members, effects.misbehaved)
    return auc(scores["misbehaviour"].score[runs.first], runs, rng).columns("auc")


def _called(
    scores: Mapping[str, HeldOutScores],
    campaign: JudgedRuns,
    members: NDArray[np.bool_],
    rng: np.random.Generator,
) -> dict[str, float]:
    """Return the share of runs that each score, and both together, call anomalous."""
    of_aspects = {aspect: of_aspect.p for aspect, of_aspect in scores.items()}
    if len(of_aspects) > 1:
        of_aspects["both"] = np.max(list(of_aspects.values()), axis=0)
    columns: dict[str, float] = {}
    for aspect, p in of_aspects.items():
        judged = members & np.isfinite(p)
        called = p[judged] <= RATE
        rate = share(called, campaign.block[judged], rng) if judged.any() else NOTHING
        columns |= rate.columns(f"called_{aspect}")
    return columns
