"""The whole evaluation of a campaign: each run once, all scores held out, with integrity checks.

The steps are in the other modules of this package; this module runs them for every scorer.
docs/explanation/evaluation.md explains the protocol and each metric.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.detectors import DetectorError, panel, upper_bounds
from oracle_pipeline.evaluation import integrity_checks
from oracle_pipeline.evaluation.alarm_metrics import WatchedRuns, judge_alarms, watched
from oracle_pipeline.evaluation.aspects import aspects_by_mode, aspects_table
from oracle_pipeline.evaluation.comparisons import (
    ALL_MODES,
    HEADLINE,
    OF_CARD,
    RATES,
    ComparedRuns,
    Scorer,
    comparisons,
    judge,
    scorers,
    unjudged,
)
from oracle_pipeline.evaluation.curves import NamedCurves, roc_curves
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate
from oracle_pipeline.evaluation.held_out import (
    HeldOutScores,
    held_out,
    supervised_scores,
)
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.kill_rates import kill_matrix
from oracle_pipeline.evaluation.open_claims import OpenClaim, open_claims
from oracle_pipeline.evaluation.reference_scores import reference_of, reference_scores, scored
from oracle_pipeline.evaluation.splits import (
    BLOCK,
    HARMLESS,
    SESSION,
    WORLD,
    Fold,
    block_folds,
    group_folds,
    tested_in,
    without_hard_negatives,
)
from oracle_pipeline.evaluation.task_effects import TaskEffects, task_effects
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.feature_sets import feature_sets
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

SEED = 50
BLOCKS_OF_SESSION = (2, 4, 8)  # blocks of the tested session used for training
UPPER_BOUND = "random_forest"  # boosted trees take minutes, so they are optional

Progress = Callable[[str], None]
Row = dict[str, float | int | str]


@dataclass(frozen=True, eq=False, slots=True)
class CampaignEvaluation:
    """The results of the evaluation of one campaign."""

    campaign: JudgedRuns
    left_out: int  # runs that ended before their onset
    seed: int  # of splits, detectors and resamples
    headline: HeldOutScores  # of the headline's scorer
    table: pd.DataFrame  # a row for each scorer, split and comparison, the headline first
    checks: list[integrity_checks.IntegrityCheck]
    open_claims: list[OpenClaim]  # what cannot be claimed yet
    watched: WatchedRuns  # by the headline's scorer, window by window
    alarms: pd.DataFrame  # metrics of those alarms
    aspect_scores: Mapping[str, HeldOutScores]  # tampering and misbehaviour, run by run
    effects: TaskEffects  # the ground truth of misbehaviour
    aspects: dict[str, pd.DataFrame]  # metrics of those scores, by table
    curves: NamedCurves  # ROC, by comparison
    kills: pd.DataFrame | None  # None without a grid


def evaluate(
    features: pd.DataFrame,
    windows: pd.DataFrame,
    truth: pd.DataFrame,
    *,
    graph_differences: Sequence[str] | None = None,
    grid: MeasuredRuns | None = None,
    bounds: Sequence[str] = (UPPER_BOUND,),
    seed: int = SEED,
    progress: Progress = lambda _: None,
) -> CampaignEvaluation:
    """Evaluate the detector panel on held-out blocks, and the headline's scorer in all analyses.

    Parameters
    ----------
    features : DataFrame
        Distinct runs, one row each.
    windows : DataFrame
        Their windows, one row each.
    truth : DataFrame
        Ground truth of each run (`truth.truth_table`).
    graph_differences : sequence of str, optional
        Differences between the graphs of pairs; None if they were not compared.
    grid : MeasuredRuns, optional
        Attacked runs at several magnitudes (`kill_rates.kill_matrix`).
    bounds : sequence of str
        Classifiers trained with labels (`upper_bounds`), as upper bounds for these features.
    seed : int
        Of splits, detectors and resamples.
    progress : callable
        Called with one line before each step.

    Raises
    ------
    DatasetError
        The tables do not fit together.
    DetectorError
        An unknown name in `bounds`.
    """
    if unknown := sorted(set(bounds) - set(upper_bounds(seed))):
        raise DetectorError(
            f"There is no upper bound {unknown[0]!r}; there are {', '.join(upper_bounds(seed))}."
        )
    steps = _Steps(JudgedRuns.of(features, windows, truth), seed, progress)
    with threadpool_limits(1, user_api="blas"):  # threads are slower on matrices this small
        return _evaluated(steps, truth, graph_differences, grid, bounds)


def _evaluated(
    steps: "_Steps",
    truth: pd.DataFrame,
    graph_differences: Sequence[str] | None,
    grid: MeasuredRuns | None,
    bounds: Sequence[str],
) -> CampaignEvaluation:
    """Run all steps; `truth` includes runs that ended before their onset."""
    steps.progress(", ".join(HEADLINE))
    headline = _supported(steps.score(HEADLINE, steps.folds))
    table = steps.table(headline, bounds)
    checks = steps.checks(headline, table, graph_differences)
    watched_runs, alarms = steps.alarms()
    effects = task_effects(steps.campaign)
    aspect_scores, aspects = steps.aspects(effects)
    steps.progress("curves")
    curves = roc_curves(headline, steps.campaign, steps.compared, steps.rng)
    kills = None
    if grid is not None:
        steps.progress("kill matrix")
        kills = kill_matrix(steps.campaign, grid, steps.seed)
    in_evaluation = truth["run_id"].isin(steps.campaign.features["run_id"])
    return CampaignEvaluation(
        campaign=steps.campaign,
        left_out=int((~in_evaluation & truth["onset_s"].isna()).sum()),
        seed=steps.seed,
        headline=headline,
        table=table,
        checks=checks,
        open_claims=open_claims(steps.campaign.features, checks),
        watched=watched_runs,
        alarms=alarms,
        aspect_scores=aspect_scores,
        effects=effects,
        aspects=aspects,
        curves=curves,
        kills=kills,
    )


def _supported(scores: HeldOutScores) -> HeldOutScores:
    """Return scores, without p-values if there are too few runs for the usual rate."""
    if scores.calibration >= runs_needed(RATES[0]):
        return scores
    return replace(scores, p=np.full_like(scores.p, np.nan))


class _Round(NamedTuple):
    """A scorer, and the folds in which it is judged."""

    scorer: Scorer
    split: str
    folds: Sequence[Fold]


class _Steps:
    """The steps for one campaign and one seed."""

    def __init__(self, campaign: JudgedRuns, seed: int, progress: Progress) -> None:
        self.campaign = campaign
        self.progress = progress
        self.seed = seed
        self.rng = np.random.default_rng(seed)
        self.detectors = panel(seed)
        self.sets = feature_sets(campaign.features)
        self.compared = comparisons(campaign.features)
        self.folds = block_folds(campaign.features, seed)
        self._references: dict[str, CrossConformalScorer | None] = {}
        self._reference_scores: dict[Scorer, HeldOutScores] = {}

    def reference(self, features: str) -> CrossConformalScorer | None:
        """Return the scorer learned from all normal runs, cached by set of features."""
        if features not in self._references:
            normal = ~self.campaign.malicious
            self._references[features] = reference_of(self.campaign, normal, features)
        return self._references[features]

    def score(self, scorer: Scorer, folds: Sequence[Fold]) -> HeldOutScores:
        if not scorer.is_of_card:
            detector, columns = self.detectors[scorer.detector], self.sets.get(scorer.features, [])
            return held_out(self.campaign, columns, detector, folds, scorer.level)
        if folds is not self.folds:
            return reference_scores(self.campaign, folds, scorer.features)
        if scorer not in self._reference_scores:
            self._reference_scores[scorer] = scored(self.campaign, self.reference(scorer.features))
        return self._reference_scores[scorer]

    def table(self, headline: HeldOutScores, bounds: Sequence[str]) -> pd.DataFrame:
        """Judge every scorer in every comparison, the headline first."""
        rows = self._rows(HEADLINE, BLOCK, headline)
        rounds = list(self._rounds())
        threads = ThreadPoolExecutor(os.cpu_count())  # NumPy releases the GIL
        try:
            for each, scores in zip(rounds, threads.map(self._attempt, rounds), strict=True):
                self.progress(f"{', '.join(each.scorer)}; held out: {each.split}")
                rows += self._judged(each, scores)
        finally:  # on an interrupt, do not wait for pending tasks
            threads.shutdown(cancel_futures=True)
        for name in bounds:
            self.progress(f"{name}, with labels")
            df, columns = self.campaign.features, self.sets.get("all", [])
            probability = supervised_scores(df, columns, upper_bounds(self.seed)[name], self.folds)
            scores = HeldOutScores(probability, np.full_like(probability, np.nan), 0)
            rows += self._rows(Scorer(f"{name} (sees labels)", "all", "run"), BLOCK, scores)
        return pd.DataFrame(rows)

    def _rounds(self) -> Iterator[_Round]:
        """Yield all scorers with their folds, except the headline's scorer on block folds."""
        for scorer in scorers(self.detectors, self.sets):
            if scorer != HEADLINE:
                yield _Round(scorer, BLOCK, self.folds)
        df = self.campaign.features
        yield _Round(HEADLINE, SESSION, group_folds(df, SESSION, self.seed))
        for blocks in BLOCKS_OF_SESSION:
            if folds := group_folds(df, SESSION, self.seed, blocks):
                yield _Round(HEADLINE, f"{SESSION} but {blocks} blocks", folds)
        if folds := group_folds(df, WORLD, self.seed):
            yield _Round(HEADLINE, WORLD, folds)
        if is_hard_negative(df).any():
            yield _Round(HEADLINE, HARMLESS, without_hard_negatives(df, self.folds))

    def _attempt(self, each: _Round) -> HeldOutScores | DetectorError:
        try:
            return self.score(each.scorer, each.folds)
        except DetectorError as error:
            return error

    def _judged(self, each: _Round, scores: HeldOutScores | DetectorError) -> list[Row]:
        if isinstance(scores, HeldOutScores):
            return self._rows(each.scorer, each.split, scores, tested_in(each.folds))
        all_modes = self.compared[0]
        row = unjudged(self.campaign, all_modes, str(scores))
        return [{**each.scorer._asdict(), "split": each.split, "scope": all_modes.name, **row}]

    def _rows(
        self,
        scorer: Scorer,
        split: str,
        scores: HeldOutScores,
        tested: NDArray[np.bool_] | None = None,
    ) -> list[Row]:
        """Judge a scorer in every comparison, on the tested runs only."""
        compared = self.compared
        if tested is not None:
            compared = [ComparedRuns(each.name, each.runs & tested) for each in compared]
        place = {**scorer._asdict(), "split": split}
        return [
            {**place, "scope": each.name, **judge(scores, self.campaign, each, self.rng)}
            for each in compared
        ]

    def alarms(self) -> tuple[WatchedRuns, pd.DataFrame]:
        """Return the alarms of the headline's scorer and their metrics."""
        self.progress("alarms")
        watched_runs = watched(self.campaign, self.reference(HEADLINE.features))
        return watched_runs, pd.DataFrame(
            {"scope": each.name, **judge_alarms(watched_runs, self.campaign, each, self.rng)}
            for each in self.compared
        )

    def aspects(
        self, effects: TaskEffects
    ) -> tuple[dict[str, HeldOutScores], dict[str, pd.DataFrame]]:
        """Return the scores of tampering and of misbehaviour, and their metrics."""
        self.progress("tampering and misbehaviour")
        scores = {
            scorer.features: _supported(self.score(scorer, self.folds))
            for scorer in OF_CARD[1:]
            if scorer.features in self.sets
        }
        of_all = (scores, self.campaign, effects)
        return scores, {
            "aspects": aspects_table(*of_all, self.compared, self.rng),
            "aspects_by_mode": aspects_by_mode(*of_all, self.rng),
            "task_uncertainty": effects.table(),
        }

    def checks(
        self, headline: HeldOutScores, table: pd.DataFrame, differences: Sequence[str] | None
    ) -> list[integrity_checks.IntegrityCheck]:
        """Return all integrity checks of the headline."""
        self.progress("integrity checks")
        campaign, columns = self.campaign, self.sets.get(HEADLINE.features, [])
        detector = self.detectors[HEADLINE.detector]
        rng = np.random.default_rng([self.seed, 1])  # independent of the number of scorers
        of_shortcuts = table[(table["features"] == "shortcuts") & (table["scope"] == ALL_MODES)]
        area = Estimate.of_row(of_shortcuts.iloc[0], "auc") if len(of_shortcuts) else NOTHING
        return [
            integrity_checks.same_between_sessions(headline, campaign, rng),
            integrity_checks.equal_graphs(differences),
            integrity_checks.label_above_session(campaign, columns, self.folds, self.seed),
            integrity_checks.shuffled_labels(campaign, columns, detector, block_folds, rng),
            integrity_checks.hard_negatives(headline, campaign, rng),
            integrity_checks.shortcuts_are_separate(campaign.features, columns, area),
            integrity_checks.unaltered_runs_alike(campaign, columns),
        ]
