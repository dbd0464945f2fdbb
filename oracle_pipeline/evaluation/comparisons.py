"""The comparisons of an evaluation: which runs, which scorer, and which metrics.

The protocol is fixed before the final data are recorded: the panel and the scorer of the headline.
docs/explanation/evaluation.md gives the reasons.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.datasets import HARD_NEGATIVE
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, share
from oracle_pipeline.scoring.conformal import runs_needed

ALL_MODES = "all modes"
NORMAL = "normal"
HARD_NEGATIVES = "hard negatives"
SHADOW = "_shadow"  # suffix of the names of shadow controls
HEADLINE = "reference card"  # the scorer of the headline, as `oracle score` uses it
OBSTACLE = ("benign_obstacle", "fake_object")  # a real and a fake object at the same place


@dataclass(frozen=True, eq=False, slots=True)
class ComparedRuns:
    """Runs that are judged together; the mask is of shape (n_runs,)."""

    name: str
    runs: NDArray[np.bool_]


def comparisons(df: pd.DataFrame) -> list[ComparedRuns]:
    """Return the comparisons that the modes of a table allow, named ``control / attacked``.

    These are all modes; each attack against its control, and against its shadow, which computes the
    attack and publishes the original; an attack without either, such as a searched one, against all
    normal modes, named ``normal / attacked``; the fake object against a real one; and the hard
    negatives, together and each. Hard negatives have no attacked run, so they measure only false
    positives.
    """
    modes = set(df["mode"])
    attacked = sorted(set(df.loc[df["label"] == "malicious", "mode"]))
    couples = [*PAIRS, *((f"{mode}{SHADOW}", mode) for mode in attacked), OBSTACLE]
    couples = [couple for couple in couples if modes.issuperset(couple)]
    benign = sorted(mode for mode in modes if mode.startswith(HARD_NEGATIVE))
    shadows = {f"{mode}{SHADOW}" for mode in attacked}
    normal = sorted(modes.difference(attacked, benign, shadows))
    alone = set(attacked).difference(*couples) if normal else set()
    named: dict[str, Collection[str]] = {
        ALL_MODES: sorted(modes),
        **{" / ".join(couple): couple for couple in couples},
        **{f"{NORMAL} / {mode}": [*normal, mode] for mode in sorted(alone)},
        **({HARD_NEGATIVES: benign} if benign else {}),
        **{mode: [mode] for mode in benign},
    }
    return [ComparedRuns(name, np.asarray(df["mode"].isin(of))) for name, of in named.items()]


def runs_of(
    campaign: JudgedRuns, members: NDArray[np.bool_], positive: NDArray[np.bool_] | None = None
) -> DistinctRuns:
    """Return the runs of a scope as input of metrics; by default the attacked ones are positive."""
    found = campaign.malicious if positive is None else positive
    return DistinctRuns.once(members, found, campaign.block)


def judge(
    scores: HeldOutScores,
    campaign: JudgedRuns,
    scope: ComparedRuns,
    rng: np.random.Generator,
    positive: NDArray[np.bool_] | None = None,
    exits: NDArray[np.float64] | None = None,
) -> dict[str, float | int | str]:
    """Return the metrics of one comparison as table columns, an estimate as three.

    These are the AUC, and the detection rate and realised false positive rate at the nominal one:
    by features alone, and of the exit code.

    Parameters
    ----------
    scores : HeldOutScores
    campaign : JudgedRuns
    scope : ComparedRuns
    rng : Generator
        Draws the resamples for the intervals.
    positive : ndarray of bool, shape (n_runs,), optional
        The runs to be detected; by default the attacked ones.
    exits : ndarray of shape (n_runs,), optional
        From `CardVerdicts.exits`.
    """
    runs = runs_of(campaign, scope.runs, positive)
    score, p = scores.score[runs.first], scores.p[runs.first]
    supported = np.isfinite(p) & (scores.calibration >= runs_needed(RATE))
    by_features = np.where(supported, p <= RATE, np.nan)
    row: dict[str, float | int | str] = {
        "malicious": int(runs.malicious.sum()),
        "normal": int((~runs.malicious).sum()),
        "blocks": len(np.unique(runs.block)),
        **auc(score, runs, rng).columns("auc"),
        **_called(by_features, runs, rng, ""),
    }
    if exits is not None:
        row |= _called(exits[runs.first], runs, rng, "exit_")
    return row | {"note": _note(np.isfinite(score), scores.calibration, runs)}


def _called(
    called: NDArray[np.float64], runs: DistinctRuns, rng: np.random.Generator, name: str
) -> dict[str, float]:
    """Return the shares of attacked and of normal runs that are called; NaN is left out."""
    known = np.isfinite(called)
    hit, malicious, block = called[known] == 1.0, runs.malicious[known], runs.block[known]
    return {
        **share(hit[malicious], block[malicious], rng).columns(f"{name}detection_rate"),
        **share(hit[~malicious], block[~malicious], rng).columns(f"{name}false_positive_rate"),
    }


def _note(scored: NDArray[np.bool_], calibration: int, runs: DistinctRuns) -> str:
    """Return a note on missing values of a row, and the reason."""
    if not scored.any():
        return (
            "no run could be scored: scores need features with values and normal runs of three "
            "blocks"
        )
    remarks = [
        f"no {name} runs"
        for name, of in (("malicious", runs.malicious), ("normal", ~runs.malicious))
        if not of.any()
    ]
    needed = runs_needed(RATE)
    if calibration < needed:
        remarks.append(f"{calibration} calibration runs, {RATE:.0%} needs {needed}")
    return "; ".join(remarks)


def unjudged(campaign: JudgedRuns, scope: ComparedRuns, note: str) -> dict[str, float | int | str]:
    """Return the row of a comparison that could not be made."""
    nowhere = np.full(len(campaign.features), np.nan)
    row = judge(HeldOutScores(nowhere, nowhere, 0), campaign, scope, np.random.default_rng(0))
    return row | {"note": note}
