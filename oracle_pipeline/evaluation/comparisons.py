"""The comparisons of an evaluation: which runs, which scorer, and which metrics.

The protocol is fixed before the final data are recorded: the panel, the sets of features and the
scorer of the headline. docs/explanation/evaluation.md gives the reasons.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.datasets import HARD_NEGATIVE
from oracle_pipeline.detectors import DEFAULT_DETECTOR
from oracle_pipeline.evaluation.held_out import HeldOutScores, Level
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, average_precision, matthews, select, share
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.feature_sets import ASPECTS

RATES = (0.05, 0.01)  # nominal false positive rates; the first is the usual one
BLOCKS_NEEDED = {0.01: 250}  # two in five calibrate, so even a single mode gives 99 runs
ONE_SIDED = 0.90  # level of a two-sided interval whose lower end is the one-sided 95% bound

ALL_MODES = "all modes"
NORMAL = "normal"
HARD_NEGATIVES = "hard negatives"
SHADOW = "_shadow"  # suffix of the names of shadow controls
OBSTACLE = ("benign_obstacle", "fake_object")  # a real and a fake object at the same place


class Scorer(NamedTuple):
    """A detector with a set of features of the run, of its windows, or of both."""

    detector: str
    features: str
    level: Level

    @property
    def is_of_card(self) -> bool:
        """Whether a reference card of these features scores in this way."""
        return (self.detector, self.level) == (HEADLINE.detector, HEADLINE.level)


HEADLINE = Scorer(DEFAULT_DETECTOR, "all", "both")
# The scorers of a reference card, in the order of the output of `oracle score`.
OF_CARD = (HEADLINE, *(Scorer(DEFAULT_DETECTOR, aspect, "both") for aspect in ASPECTS))


def scorers(detectors: Iterable[str], sets: Iterable[str]) -> list[Scorer]:
    """Return all scorers that are judged, the headline's first.

    These are its detector at every level and on every set of features, and all other detectors.
    """
    named = [
        HEADLINE,
        *(Scorer(HEADLINE.detector, HEADLINE.features, level) for level in ("run", "windows")),
        *(Scorer(detector, HEADLINE.features, "run") for detector in detectors),
        *(Scorer(HEADLINE.detector, features, HEADLINE.level) for features in sets),
    ]
    return list(dict.fromkeys(named))


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
) -> dict[str, float | int | str]:
    """Return the metrics of one comparison as table columns, an estimate as three.

    These are the AUC and average precision, and at each nominal false positive rate the detection
    rate, the realised rate and its one-sided 95% lower bound, Matthews' correlation and balanced
    accuracy, as far as the campaign is large enough. `positive`, of shape (n_runs,), marks the runs
    to be detected, by default the attacked ones.
    """
    runs = runs_of(campaign, scope.runs, positive)
    score, p = scores.score[runs.first], scores.p[runs.first]
    row: dict[str, float | int | str] = {
        "malicious": int(runs.malicious.sum()),
        "normal": int((~runs.malicious).sum()),
        "blocks": len(np.unique(runs.block)),
        "prevalence": float(runs.malicious.mean()),
        **auc(score, runs, rng).columns("auc"),
        **average_precision(score, runs, rng).columns("average_precision"),
    }
    blocks = len(np.unique(campaign.block))
    for rate in RATES:
        lacking = max(0, BLOCKS_NEEDED.get(rate, 0) - blocks)
        supported = lacking == 0 and scores.calibration >= runs_needed(rate)
        row |= _at_rate(p if supported else np.full_like(p, np.nan), runs, rate, rng)
        if rate in BLOCKS_NEEDED:
            row[f"blocks_lacking_{100 * rate:g}"] = lacking
    return row | {"note": _note(np.isfinite(score), scores.calibration, runs)}


def _at_rate(
    p: NDArray[np.float64], runs: DistinctRuns, rate: float, rng: np.random.Generator
) -> dict[str, float | int | str]:
    """Return the metrics of the verdict ``p <= rate``; runs with a NaN in `p` are left out."""
    with_p = np.isfinite(p)
    judged, flagged = select(runs, with_p), p[with_p] <= rate
    normal, flag = ~judged.malicious, flagged.astype(np.float64)
    block = judged.block
    name = f"{100 * rate:g}"
    return {
        **share(flagged[~normal], block[~normal], rng).columns(f"detection_rate_{name}"),
        **share(flagged[normal], block[normal], rng).columns(f"false_alarm_rate_{name}"),
        f"false_alarm_rate_{name}_bound": share(flagged[normal], block[normal], rng, ONE_SIDED).low,
        **matthews(flagged, judged, rng).columns(f"mcc_{name}"),
        **auc(flag, judged, rng).columns(f"balanced_accuracy_{name}"),
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
    needed = runs_needed(RATES[0])
    if calibration < needed:
        remarks.append(f"{calibration} calibration runs, {RATES[0]:.0%} needs {needed}")
    return "; ".join(remarks)


def unjudged(campaign: JudgedRuns, scope: ComparedRuns, note: str) -> dict[str, float | int | str]:
    """Return the row of a comparison that could not be made."""
    nowhere = np.full(len(campaign.features), np.nan)
    row = judge(HeldOutScores(nowhere, nowhere, 0), campaign, scope, np.random.default_rng(0))
    return row | {"note": note}
