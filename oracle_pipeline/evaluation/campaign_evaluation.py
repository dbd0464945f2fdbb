"""The whole evaluation of a campaign: each run once, all verdicts held out, with integrity checks.

The steps are in the other modules of this package. docs/explanation/evaluation.md explains the
protocol and each metric.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.detectors import Detector, DetectorError, panel, single_threaded
from oracle_pipeline.evaluation import integrity_checks, splits
from oracle_pipeline.evaluation.alarm_metrics import judge_alarms
from oracle_pipeline.evaluation.aspects import aspects_table
from oracle_pipeline.evaluation.card_verdicts import (
    RATE,
    CardVerdicts,
    Each,
    Observations,
    card_folds,
    card_verdicts,
)
from oracle_pipeline.evaluation.comparisons import (
    HEADLINE,
    ComparedRuns,
    comparisons,
    judge,
    unjudged,
)
from oracle_pipeline.evaluation.held_out import HeldOutScores, held_out
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.kill_rates import kill_matrix
from oracle_pipeline.evaluation.open_claims import open_claims
from oracle_pipeline.evaluation.task_effects import TaskEffects, task_effects
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.feature_sets import ASPECTS, feature_sets
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

SEED = 50

Progress = Callable[[str], None]
Row = dict[str, float | int | str]


@dataclass(frozen=True, eq=False, slots=True)
class CampaignEvaluation:
    """The results of the evaluation of one campaign."""

    campaign: JudgedRuns
    left_out: int  # runs that ended before their onset
    seed: int  # of splits, detectors and resamples
    verdicts: CardVerdicts  # of `oracle score`, by cards of other blocks
    headline: HeldOutScores  # of those verdicts
    table: pd.DataFrame  # a row for each detector, split and comparison, the headline first
    checks: list[integrity_checks.IntegrityCheck]
    open_claims: pd.DataFrame  # what cannot be claimed yet
    alarms: pd.DataFrame  # metrics of the alarms of those verdicts
    aspect_scores: Mapping[str, HeldOutScores]  # tampering and misbehaviour, run by run
    effects: TaskEffects  # the ground truth of misbehaviour
    aspects: dict[str, pd.DataFrame]  # metrics of those scores, by table
    kills: pd.DataFrame | None  # None without a grid


def evaluate(
    features: pd.DataFrame, windows: pd.DataFrame, truth: pd.DataFrame, *,
    observations: Observations | None = None, graph_differences: Sequence[str] | None = None,
    grid: MeasuredRuns | None = None, seed: int = SEED, progress: Progress = lambda _: None,
    each: Each = map,
) -> CampaignEvaluation:  # fmt: skip
    """Evaluate the verdicts of reference cards on runs of other blocks, and compare detectors.

    Parameters
    ----------
    features : DataFrame
        Distinct runs, one row each.
    windows : DataFrame
        Their windows, one row each.
    truth : DataFrame
        Ground truth of each run (`truth.truth_table`).
    observations : mapping of str to Observation, optional
        Interfaces of the runs, for the contract. Without those of all runs, there is none.
    graph_differences : sequence of str, optional
        Differences between the graphs of pairs; None if they were not compared.
    grid : MeasuredRuns, optional
        Attacked runs at several magnitudes (`kill_rates.kill_matrix`).
    seed : int
        Of splits, detectors and resamples.
    progress : callable
        Called with one line before each step.
    each : callable
        Judges the runs of several cards (`card_verdicts`).

    Raises
    ------
    DatasetError
        The tables do not fit together.
    """
    campaign = JudgedRuns.of(features, windows, truth)
    steps = _Steps(campaign, observations or {}, seed, progress, each)
    with single_threaded():
        return _evaluated(steps, truth, graph_differences, grid)


def _evaluated(
    steps: "_Steps",
    truth: pd.DataFrame,
    graph_differences: Sequence[str] | None,
    grid: MeasuredRuns | None,
) -> CampaignEvaluation:
    """Run all steps; `truth` includes runs that ended before their onset."""
    campaign = steps.campaign
    verdicts = steps.verdicts(splits.BLOCK, steps.folds)
    headline = _supported(verdicts.scores())
    checks = steps.checks(headline, graph_differences)
    effects = task_effects(campaign)
    aspect_scores = {name: _supported(verdicts.scores(name)) for name in ASPECTS}
    aspect_scores = {n: of for n, of in aspect_scores.items() if np.isfinite(of.score).any()}
    of_all = (aspect_scores, campaign, effects)
    kills = None
    if grid is not None:
        steps.progress("kill matrix")
        kills = kill_matrix(campaign, grid, steps.seed)
    in_evaluation = truth["run_id"].isin(campaign.features["run_id"])
    return CampaignEvaluation(
        campaign=campaign,
        left_out=int((~in_evaluation & truth["onset_s"].isna()).sum()),
        seed=steps.seed,
        verdicts=verdicts,
        headline=headline,
        table=pd.DataFrame(steps.rows(verdicts)),
        checks=checks,
        open_claims=open_claims(campaign.features, checks),
        alarms=pd.DataFrame(
            {"scope": each.name, **judge_alarms(verdicts, campaign, each, steps.rng)}
            for each in steps.compared
        ),
        aspect_scores=aspect_scores,
        effects=effects,
        aspects={
            "aspects": aspects_table(*of_all, steps.compared, steps.rng),
            "task_uncertainty": effects.table(),
        },
        kills=kills,
    )


def _supported(scores: HeldOutScores) -> HeldOutScores:
    """Return scores, without p-values if there are too few runs for the usual rate."""
    if scores.calibration >= runs_needed(RATE):
        return scores
    return replace(scores, p=np.full_like(scores.p, np.nan))


@dataclass(eq=False)
class _Steps:
    """The steps for one campaign and one seed."""

    campaign: JudgedRuns
    observations: Observations
    seed: int
    progress: Progress
    each: Each

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.columns = feature_sets(self.campaign.features).get("all", [])
        self.compared = comparisons(self.campaign.features)
        self.folds = card_folds(self.campaign.features, self.seed)

    def verdicts(self, split: str, folds: Sequence[splits.Fold]) -> CardVerdicts:
        """Judge all tested runs by the cards of their folds."""
        self.progress(f"{HEADLINE}; held out: {split}")
        return card_verdicts(self.campaign, folds, self.observations, self.each)

    def rows(self, verdicts: CardVerdicts) -> Iterator[Row]:
        """Yield the rows of the verdicts in each comparison, then of all detectors."""
        yield from self._of_cards(splits.BLOCK, self.folds, verdicts)
        df = self.campaign.features
        if folds := splits.group_folds(df, splits.WORLD, self.seed):
            yield from self._of_cards(splits.WORLD, folds, self.verdicts(splits.WORLD, folds))
        if is_hard_negative(df).any() and (folds := splits.without_hard_negatives(df, self.folds)):
            yield from self._of_cards(splits.HARMLESS, folds, self.verdicts(splits.HARMLESS, folds))
        for name, detector in panel(self.seed).items():
            self.progress(name)
            yield {"detector": name, "split": splits.BLOCK, **self._of_detector(detector)}

    def _of_cards(
        self, split: str, folds: Sequence[splits.Fold], verdicts: CardVerdicts
    ) -> Iterator[Row]:
        """Yield a row for each comparison, on the tested runs only."""
        tested, scores = splits.tested_in(folds), verdicts.scores()
        for each in self.compared:
            scope = ComparedRuns(each.name, each.runs & tested)
            row = judge(scores, self.campaign, scope, self.rng, exits=verdicts.exits())
            yield {"detector": HEADLINE, "split": split, "scope": each.name, **row}

    def _of_detector(self, detector: Detector) -> Row:
        all_modes, folds = self.compared[0], splits.block_folds(self.campaign.features, self.seed)
        try:
            scores = held_out(self.campaign, self.columns, detector, folds)
        except DetectorError as error:
            row = unjudged(self.campaign, all_modes, str(error))
        else:
            row = judge(scores, self.campaign, all_modes, self.rng)
        return {"scope": all_modes.name, **row}

    def checks(
        self, headline: HeldOutScores, differences: Sequence[str] | None
    ) -> list[integrity_checks.IntegrityCheck]:
        """Return all integrity checks of the headline."""
        self.progress("integrity checks")
        campaign = self.campaign
        rng = np.random.default_rng([self.seed, 1])  # independent of the number of detectors
        return [
            integrity_checks.same_between_sessions(headline, campaign, rng),
            integrity_checks.equal_graphs(differences),
            integrity_checks.hard_negatives(headline, campaign, rng),
            integrity_checks.unaltered_runs_alike(campaign, self.columns),
        ]
