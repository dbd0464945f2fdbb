"""Integrity checks of the evaluation itself: each with a value and a sentence.

A check is green, red, or unsupported: the campaign has no runs for it, or it could not fail with
these runs, whatever they show. With a red check, the report claims nothing.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, count
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.evaluation.audit import audit, blocks_needed, exact_pairs, unmatched
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.comparisons import runs_of
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate, newcombe_auc
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, share

CheckStatus = Literal["green", "red", "unsupported"]

SAME = 0.999  # confidence level at which equal groups must not differ
FALSE_ALARMS = 0.10  # highest false positive rate on hard negatives


@dataclass(frozen=True, slots=True)
class IntegrityCheck:
    """One integrity check's result."""

    name: str
    status: CheckStatus
    figure: Estimate
    sentence: str

    def columns(self) -> dict[str, float | str]:
        """Return the check as table columns, its value as three."""
        named = asdict(self)
        return {k: named[k] for k in ("name", "status", "sentence")} | self.figure.columns("figure")


def _found(name: str, *, passed: bool, figure: Estimate, sentence: str) -> IntegrityCheck:
    return IntegrityCheck(name, "green" if passed else "red", figure, sentence)


def _unsupported(name: str, why: str) -> IntegrityCheck:
    return IntegrityCheck(name, "unsupported", NOTHING, why)


def same_between_sessions(
    scores: HeldOutScores, campaign: JudgedRuns, rng: np.random.Generator
) -> IntegrityCheck:
    """A/A: runs of one control mode in two sessions, on disjoint blocks, score alike.

    The value is the AUC that is furthest from 0.5, with its 99.9% interval.
    """
    name, areas = "sessions_score_alike", []
    for mode, _ in PAIRS:
        members = (campaign.features["mode"] == mode).to_numpy() & np.isfinite(scores.score)
        groups = _large_sessions(campaign.features, members)
        for one, other in combinations(groups, 2):
            both = groups[one] | groups[other]
            runs = runs_of(campaign, both)
            later = DistinctRuns(runs.first, runs.copies, groups[other][both], runs.block)
            area = auc(scores.score[both], later, rng, SAME)
            areas.append((abs(area.value - 0.5), f"{mode}, {one} and {other}", area))
    if not areas:
        return _unsupported(name, _TOO_FEW_IN_SESSIONS)
    _, where, area = max(areas)
    passed = area.covers(0.5)
    return _found(
        name,
        passed=passed,
        figure=area,
        sentence=f"{where}: AUC {area} (99.9%) {'contains' if passed else 'does not contain'} "
        f"0.5; it is the furthest from 0.5 of {len(areas)}.",
    )


def blocks_to_separate() -> int:
    """Return how many blocks each of two sessions needs before they can be distinguished.

    With fewer blocks, the interval of `same_between_sessions` contains 0.5 even for perfectly
    separated sessions.
    """
    return next(n for n in count(2) if not newcombe_auc(1.0, n, n, SAME).covers(0.5))


_TOO_FEW_IN_SESSIONS = (
    f"It could not fail with these runs: sessions of fewer than {blocks_to_separate()} blocks "
    "differ as their blocks do. The check needs so many blocks in each of two sessions "
    "(ORACLE_SESSIONS=2)."
)


def _large_sessions(
    features: pd.DataFrame, members: NDArray[np.bool_]
) -> dict[str, NDArray[np.bool_]]:
    """Return the sessions that have enough blocks to be compared, as masks of shape (n_runs,)."""
    session, block = (features[key].to_numpy() for key in ("session", "block"))
    of_session = {f"session {name}": members & (session == name) for name in np.unique(session)}
    needed = blocks_to_separate()
    return {name: of for name, of in of_session.items() if len(np.unique(block[of])) >= needed}


def equal_graphs(differences: Sequence[str] | None) -> IntegrityCheck:
    """Pairs that should have equal graphs have them.

    Parameters
    ----------
    differences : sequence of str, optional
        One sentence each; None if graphs were not compared.
    """
    name = "graphs_of_pairs_are_equal"
    if differences is None:
        return _unsupported(name, "The graphs of pairs were not compared; run the graph check.")
    count = Estimate(*[float(len(differences))] * 3)
    named = "; ".join(differences[:3]) or "vertices, types and edges agree in every interval"
    return _found(name, passed=not differences, figure=count, sentence=f"{named}.")


def hard_negatives(
    scores: HeldOutScores, campaign: JudgedRuns, rng: np.random.Generator
) -> IntegrityCheck:
    """Hard negatives, normal runs with a harmless change, are rarely called anomalous."""
    name, harmless = "hard_negatives_pass", is_hard_negative(campaign.features)
    judged = harmless & np.isfinite(scores.p)
    if not harmless.any():
        return _unsupported(name, "There are no hard negatives; record the benign_* modes.")
    rate = share(scores.p[judged] <= RATE, campaign.block[judged], rng)
    passed = rate.value <= FALSE_ALARMS
    blocks, needed = len(np.unique(campaign.block[judged])), blocks_to_exclude(FALSE_ALARMS)
    if not len(scores.p[judged]) or (passed and blocks < needed):
        return _unsupported(
            name,
            f"{blocks} blocks of hard negatives have a verdict; even without a false alarm, "
            f"{needed} are needed to exclude a rate above {FALSE_ALARMS:.0%}.",
        )
    return _found(
        name,
        passed=passed,
        figure=rate,
        sentence=f"{rate} of {judged.sum()} hard negatives are called anomalous at a nominal "
        f"{RATE:.0%}; at most {FALSE_ALARMS:.0%} may be.",
    )


def blocks_to_exclude(rate: float, confidence: float = 0.95) -> int:
    """Return how many blocks without a false positive exclude a rate above `rate`.

    Examples
    --------
    >>> blocks_to_exclude(0.10), blocks_to_exclude(0.05)
    (29, 59)
    """
    return int(np.ceil(np.log(1.0 - confidence) / np.log(1.0 - rate)))


def unaltered_runs_alike(campaign: JudgedRuns, columns: Sequence[str]) -> IntegrityCheck:
    """No feature of the headline distinguishes unaltered runs.

    No feature may distinguish a shadow control from its passthrough, or one session from another.
    A feature may distinguish unaltered modes (by their subscriptions) if each attacked mode has an
    unaltered counterpart. The value is the number of features that violate this rule.
    """
    name, df = "unaltered_runs_are_alike", campaign.features
    pairs, needed = exact_pairs(df), blocks_needed(len(columns))
    blocks = [
        len(set(df.loc[df["mode"] == one, "block"]) & set(df.loc[df["mode"] == other, "block"]))
        for one, other in pairs
    ]
    if min(blocks, default=0) < needed:
        return _unsupported(
            name,
            f"The check needs a passthrough and its shadow in {needed} blocks; record *_shadow "
            "modes.",
        )
    found, alone = audit(df, columns), unmatched(df)
    wrong = found if alone else found[found["tells"] != "mode"]
    features = wrong["feature"].unique()
    named = ", ".join(f"{each.feature} ({each.between})" for each in wrong[:3].itertuples())
    of_modes = found.loc[found["tells"] == "mode", "feature"].nunique()
    matched = f"{', '.join(alone)} without" if alone else "each attacked mode with"
    return _found(
        name,
        passed=wrong.empty,
        figure=Estimate(*[float(len(features))] * 3),
        sentence=f"{len(features)} of {len(columns)} features distinguish unaltered runs"
        f"{f': {named}' if named else ''}. {of_modes} distinguish unaltered modes by their "
        f"subscriptions, {matched} an unaltered counterpart.",
    )
