"""The curves of the headline's scorer: ROC, detection rate over nominal rate, and effort."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.evaluation.comparisons import OBSTACLE, ComparedRuns, runs_of
from oracle_pipeline.evaluation.effort import EffortCurve, effort_curve
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import RocCurve, auc, roc_curve, share

RATES = 40  # nominal false positive rates at which detection is measured


class Curve(NamedTuple):
    """A line with a band around it, if it has one; arrays of shape (n,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    low: NDArray[np.float64] | None = None
    high: NDArray[np.float64] | None = None


class HeadlineCurves(NamedTuple):
    """The curves by which one scorer is judged."""

    roc: Mapping[str, tuple[RocCurve, Estimate]]  # by comparison, with the AUC
    detection: Mapping[str, Curve]  # share of ``p <= rate``, by attacked mode and of normal runs
    effort: EffortCurve


def headline_curves(
    scores: HeldOutScores,
    campaign: JudgedRuns,
    compared: Sequence[ComparedRuns],
    rng: np.random.Generator,
) -> HeadlineCurves | None:
    """Return the curves of a scorer; None if only one class of runs has scores.

    Parameters
    ----------
    scores : HeldOutScores
    campaign : JudgedRuns
    compared : sequence of ComparedRuns
        From `comparisons.comparisons`, all modes first.
    rng : Generator
        Draws the resamples behind the bands.
    """
    if not _both_classes(compared[0], scores, campaign):
        return None
    roc = {}
    for each in _shown(compared):
        if _both_classes(each, scores, campaign):
            runs = runs_of(campaign, each.runs)
            score = scores.score[runs.first]
            roc[each.name] = (roc_curve(score, runs, rng), auc(score, runs, rng))
    effort = effort_curve(scores.score, campaign.malicious)
    return HeadlineCurves(roc, _detection(scores, campaign, rng), effort)


def _shown(compared: Sequence[ComparedRuns]) -> list[ComparedRuns]:
    """Return the comparison of all modes, and of each attack with its shadow or else control."""
    all_modes, *others = compared
    pairs = [each for each in others if "/" in each.name]
    against_normal = [each for each in pairs if each.name != " / ".join(OBSTACLE)]
    return [all_modes, *{each.name.split(" / ")[1]: each for each in against_normal}.values()]


def _both_classes(compared: ComparedRuns, scores: HeldOutScores, campaign: JudgedRuns) -> bool:
    scored = compared.runs & np.isfinite(scores.score)
    return len(np.unique(campaign.malicious[scored])) == 2


def _detection(
    scores: HeldOutScores, campaign: JudgedRuns, rng: np.random.Generator
) -> dict[str, Curve]:
    """Return for each attacked mode, and for normal runs, the share of ``p <= rate``.

    NaN where there are too few blocks for p-values.
    """
    if not np.isfinite(scores.p).any():
        return {}
    rates = np.geomspace(1.0 / (scores.calibration + 1), 1.0, RATES)
    modes, malicious = campaign.features["mode"].to_numpy(), campaign.malicious
    groups = {str(mode): modes == mode for mode in np.unique(modes[malicious])}
    curves = {}
    for name, members in {**groups, "normal runs": ~malicious}.items():
        with_p = members & np.isfinite(scores.p)
        block = campaign.block[with_p]
        shares = [share(scores.p[with_p] <= rate, block, rng) for rate in rates]
        y, low, high = (
            np.array([getattr(s, end) for s in shares]) for end in ("value", "low", "high")
        )
        curves[name] = Curve(rates, y, low, high)
    return curves
