"""Integrity checks of the evaluation itself: each with a value and a sentence.

A check is green, red, or unsupported if the campaign has no runs for it, or too few for it to be
able to fail. The report claims an AUC once all are green.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, count
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.datasets import field_metadata, is_hard_negative
from oracle_pipeline.detectors import Detector, upper_bounds
from oracle_pipeline.evaluation.audit import audit, blocks_needed, exact_pairs, unmatched
from oracle_pipeline.evaluation.comparisons import RATES, runs_of
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate, newcombe_auc
from oracle_pipeline.evaluation.held_out import (
    HeldOutScores,
    fold_scores,
    of_tested,
    supervised_scores,
)
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, share
from oracle_pipeline.evaluation.splits import Fold
from oracle_pipeline.scoring.feature_sets import LEFT_OUT, feature_sets

CheckStatus = Literal["green", "red", "unsupported"]

SAME = 0.999  # confidence level at which equal groups must not differ
MARGIN = 0.1  # required lead of the AUC of the label over that of the session
TREES = 100  # of the forest that predicts both
SHUFFLES, SHUFFLED = 200, (0.45, 0.55)  # label permutations, and the range of their mean AUC
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

    If sessions have few blocks, the earlier half of the sessions is compared with the later.
    The value is the AUC that is furthest from 0.5, with its 99.9% interval.
    """
    name, areas = "sessions_score_alike", []
    for mode, _ in PAIRS:
        members = (campaign.features["mode"] == mode).to_numpy() & np.isfinite(scores.score)
        groups = _session_groups(campaign.features, members)
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
    f"Fewer than {blocks_to_separate()} blocks on either side cannot be distinguished, however "
    f"they differ: the check needs {blocks_to_separate()} blocks in each of two sessions, or "
    f"{2 * blocks_to_separate()} blocks in separate sessions."
)


def _session_groups(
    features: pd.DataFrame, members: NDArray[np.bool_]
) -> dict[str, NDArray[np.bool_]]:
    """Return the sessions that can be compared, by name, as masks of shape (n_runs,).

    Parameters
    ----------
    features : DataFrame
        A row for each run.
    members : ndarray of bool, shape (n_runs,)
        The runs to consider.

    Returns
    -------
    dict
        Each session with enough blocks; if there are fewer than two, the earlier and the later half
        of the sessions; empty if those have too few blocks.
    """
    session, block = (features[key].to_numpy() for key in ("session", "block"))
    numbers, half = np.unique(session[members]), len(np.unique(session[members])) // 2
    alone = {f"session {number}": members & (session == number) for number in numbers}
    halves = {
        "earlier sessions": members & np.isin(session, numbers[:half]),
        "later sessions": members & np.isin(session, numbers[half:]),
    }
    for groups in (alone, halves):
        needed = blocks_to_separate()
        large = {name: m for name, m in groups.items() if len(np.unique(block[m])) >= needed}
        if len(large) > 1:
            return large
    return {}


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


def label_above_session(
    campaign: JudgedRuns, columns: Sequence[str], folds: Sequence[Fold], seed: int
) -> IntegrityCheck:
    """One classifier on the same features predicts the attack better than the session.

    The value is the macro-averaged AUC of predicting the session on held-out blocks.
    """
    name, df = "label_is_predicted_better_than_session", campaign.features
    classifier = upper_bounds(seed)["random_forest"].set_params(n_estimators=TREES)
    label = supervised_scores(df, columns, classifier, folds)
    targets = list(_session_groups(df, np.ones(len(df), dtype=np.bool_)).values())
    if not targets:
        return _unsupported(name, _TOO_FEW_IN_SESSIONS)
    areas = [
        _area(supervised_scores(df, columns, classifier, folds, target), target)
        for target in (targets if len(targets) > 2 else targets[:-1])
    ]
    of_label = _area(label, campaign.malicious)
    if np.isnan([*areas, of_label]).any():
        return _unsupported(name, "The check needs both classes in three blocks of each session.")
    of_session = float(np.mean(areas))
    passed = of_session <= of_label - MARGIN
    meaning = "" if passed else " Verdicts may not hold in a session without normal runs."
    return _found(
        name,
        passed=passed,
        figure=Estimate(of_session, min(areas), max(areas)),
        sentence=f"AUC of the session {of_session:.2f} ({min(areas):.2f} to {max(areas):.2f} by "
        f"session), of the label {of_label:.2f}; the first should be {MARGIN} lower.{meaning}",
    )


def _area(score: NDArray[np.float64], target: NDArray[np.bool_]) -> float:
    scored = np.isfinite(score)
    if len(np.unique(target[scored])) < 2:
        return np.nan
    return float(roc_auc_score(target[scored], score[scored]))


def shuffled_labels(
    campaign: JudgedRuns,
    columns: Sequence[str],
    detector: Detector,
    make_folds: Callable[[pd.DataFrame, int], list[Fold]],
    rng: np.random.Generator,
) -> IntegrityCheck:
    """Labels that are permuted within blocks are not predicted, so no label leaks into a score.

    Each permutation fits a new model, on one fold in turn.

    Parameters
    ----------
    make_folds : callable
        Takes run table and seed, and returns folds: the split of the evaluation.
    """
    name, areas = "shuffled_labels_are_chance", []
    blocks = campaign.features.groupby("block").indices
    for number in range(SHUFFLES):
        order = np.arange(len(campaign.features))
        for rows in blocks.values():
            order[rows] = rng.permutation(rows)
        shuffled = campaign.features.assign(label=campaign.features["label"].to_numpy()[order])
        folds = make_folds(shuffled, number)
        if folds:
            fold = folds[number % len(folds)]
            score = of_tested(fold_scores(shuffled, columns, detector, [fold]), [fold])
            areas.append(_area(score, (shuffled["label"] == "malicious").to_numpy()))
    finite = np.array(areas)[np.isfinite(areas)]
    if len(finite) < SHUFFLES // 2:
        return _unsupported(name, "The check needs both classes in at least three blocks.")
    error = 1.96 * float(finite.std(ddof=1)) / np.sqrt(len(finite))
    mean = float(finite.mean())
    low, high = SHUFFLED
    return _found(
        name,
        passed=low <= mean <= high,
        figure=Estimate(mean, mean - error, mean + error),
        sentence=f"Mean AUC of {len(finite)} permutations {mean:.3f}; it should be in "
        f"[{low}, {high}].",
    )


def hard_negatives(
    scores: HeldOutScores, campaign: JudgedRuns, rng: np.random.Generator
) -> IntegrityCheck:
    """Hard negatives, normal runs with a harmless change, are rarely called anomalous."""
    name, harmless = "hard_negatives_pass", is_hard_negative(campaign.features)
    judged = harmless & np.isfinite(scores.p)
    if not harmless.any():
        return _unsupported(name, "There are no hard negatives; record the benign_* modes.")
    rate = share(scores.p[judged] <= RATES[0], campaign.block[judged], rng)
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
        f"{RATES[0]:.0%}; at most {FALSE_ALARMS:.0%} may be.",
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


def shortcuts_are_separate(
    features: pd.DataFrame, columns: Sequence[str], of_shortcuts: Estimate
) -> IntegrityCheck:
    """No headline feature identifies a run by its nodes or by how it was recorded.

    Parameters
    ----------
    features : DataFrame
    columns : sequence of str
        Features of the headline.
    of_shortcuts : Estimate
        AUC of the shortcut features alone, which is the value of the check.
    """
    name, fields = "shortcuts_are_apart", field_metadata(features)
    undeclared = [column for column in columns if "shortcut" not in fields.get(column, {})]
    if undeclared:
        return _unsupported(
            name,
            f"{undeclared[0]} and {len(undeclared) - 1} more do not declare whether they are "
            "shortcuts.",
        )
    shortcuts = feature_sets(features).get("shortcuts", [])
    mixed = [c for c in columns if c in shortcuts or c.split(".", 1)[0] in LEFT_OUT]
    summary = f"{len(shortcuts)} shortcut features are reported separately (AUC {of_shortcuts})"
    return _found(
        name,
        passed=not mixed,
        figure=of_shortcuts,
        sentence=f"The headline uses {', '.join(mixed)}." if mixed else f"{summary}.",
    )


def banner(checks: Sequence[IntegrityCheck]) -> str:
    """Return the sentences of all checks that are not green; empty if all are."""
    return " ".join(
        f"{check.name} is {check.status}: {check.sentence}"
        for check in checks
        if check.status != "green"
    )
