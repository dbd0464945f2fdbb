"""Our own evaluation as a `Report`: each run once, every score held out, checks before figures.

What is measured lives in ``oracle_pipeline.evaluation``; here it is put into tables and pictures.
The protocol and what each figure means: docs/explanation/evaluation.md.
"""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.tree import ClusteringError
from oracle_pipeline.datasets import content_hash, is_hard_negative
from oracle_pipeline.detectors import DetectorError, panel, upper_bounds
from oracle_pipeline.evaluation import integrity
from oracle_pipeline.evaluation.alarms import judge_alarms, window_p
from oracle_pipeline.evaluation.campaign import Campaign, Runs, feature_sets
from oracle_pipeline.evaluation.conformal import runs_needed
from oracle_pipeline.evaluation.effort import effort_curve, small_clusters_table
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate
from oracle_pipeline.evaluation.grid import kill_matrix, minimum_detectable, mutation_scores
from oracle_pipeline.evaluation.metrics import auc, roc_curve, share
from oracle_pipeline.evaluation.protocol import (
    ALL_MODES,
    HEADLINE,
    OBSTACLE,
    RATES,
    Scope,
    Scorer,
    judge,
    runs_of,
    scopes,
    scorers,
    unjudged,
)
from oracle_pipeline.evaluation.scoring import (
    HeldOut,
    calibration_runs,
    held_out,
    of_tested,
    standardised,
    supervised_scores,
    window_scores,
)
from oracle_pipeline.evaluation.splits import (
    BLOCK,
    HARMLESS,
    SESSION,
    Fold,
    block_folds,
    session_folds,
    tested_in,
    untaught,
)
from oracle_pipeline.reporting import figures
from oracle_pipeline.reporting.figures import Curve
from oracle_pipeline.reporting.result import Report, facts
from oracle_pipeline.reporting.thesis_tables import estimate

SEED = 50
KNOWN = (2, 4, 8)  # blocks of an otherwise unknown session that train
UPPER_BOUND = "random_forest"  # boosted trees take minutes and bound nothing else

Progress = Callable[[str], None]


def oracle_evaluation(
    features: pd.DataFrame,
    windows: pd.DataFrame,
    truth: pd.DataFrame,
    *,
    graph_differences: Sequence[str] | None = None,
    grid: Runs | None = None,
    seed: int = SEED,
    progress: Progress = lambda _: None,
) -> Report:
    """Judge the detector panel on held-out blocks, and the headline's scorer in every way.

    Parameters
    ----------
    features : DataFrame
        Distinct runs, a row each.
    windows : DataFrame
        Their windows, a row each.
    truth : DataFrame
        What happened in each (`oracle_pipeline.evaluation.truth.truth_table`).
    graph_differences : sequence of str, optional
        Between graphs of pairs that should be equal; None if they were not compared.
    grid : Runs, optional
        Attacked runs at several magnitudes (`oracle_pipeline.evaluation.grid.kill_matrix`).
    seed : int
        Of splits, detectors and resamples.
    progress : callable
        Told what is being done, a line each time.

    Returns
    -------
    Report
        The table has a row for each scorer, split and scope, the headline first; the tables
        ``alarms``, ``small_clusters``, ``checks``, ``runs`` and, with a grid, ``kills``,
        ``mutation_scores`` and ``minimum_detectable`` the rest.

    Raises
    ------
    CampaignError
        The tables do not fit together.
    """
    campaign = Campaign.of(features, windows, truth)
    evaluation = _Evaluation(campaign, seed, progress)
    headline = evaluation.score(HEADLINE, evaluation.folds)
    table = evaluation.table(headline)
    checks = evaluation.checks(headline, table, graph_differences)
    tables = {
        "alarms": evaluation.alarms(),
        "small_clusters": evaluation.small_clusters(),
        "checks": pd.DataFrame([check.columns() for check in checks]),
        "runs": campaign.features[["run_id", "mode", "label", "block", "session"]].assign(
            score=headline.score, p=headline.p
        ),
    }
    pictures = evaluation.pictures(headline)
    if grid is not None:
        progress("kill matrix")
        kills = kill_matrix(campaign, grid, seed)
        tables |= {
            "kills": kills,
            "mutation_scores": mutation_scores(kills),
            "minimum_detectable": minimum_detectable(kills),
        }
        pictures |= _kill_pictures(kills)
    area = estimate(table.iloc[0], "auc")
    doubts = integrity.banner(checks)
    summary: dict[str, float | int | str] = {
        "headline": f"Withheld. {doubts}" if doubts else said(area),
        "banner": doubts,
        "scorer": f"{HEADLINE.detector} on {HEADLINE.features} features, level {HEADLINE.level}",
        "malicious_runs": int(campaign.malicious.sum()),
        "right_runs": int((~campaign.malicious).sum()),
        "blocks": len(np.unique(campaign.block)),
        "left_out": len(features) - len(campaign.features),
        "seed": seed,
        "content_hash": content_hash(campaign.features),
        **facts("auc", area),
        **facts("detection_rate_5", estimate(table.iloc[0], "detection_rate_5")),
        **facts("false_alarm_rate_5", estimate(table.iloc[0], "false_alarm_rate_5")),
    }
    return Report(table, pictures, summary, tables)


def said(area: Estimate) -> str:
    """Say in words what an AUC with its interval supports, and no more.

    Examples
    --------
    >>> said(Estimate(0.55, 0.41, 0.68))
    'Attacked and right runs cannot be told apart: AUC 0.55 [0.41, 0.68] holds 0.5, or chance.'
    """
    if np.isnan(area.value):
        return "Nothing could be measured; the notes say why."
    if area.covers(0.5):
        return f"Attacked and right runs cannot be told apart: AUC {area} holds 0.5, or chance."
    if area.high < 0.5:
        return f"Attacked runs look more ordinary than right ones: AUC {area}, below chance."
    if area.low < 0.85:
        return f"Attacked runs stand out, but not reliably: AUC {area}, above chance."
    return f"Attacked runs stand out clearly: AUC {area}."


class _Evaluation:
    """One campaign, one seed: the parts of the report."""

    def __init__(self, campaign: Campaign, seed: int, progress: Progress) -> None:
        self.campaign = campaign
        self.progress = progress
        self.seed = seed
        self.rng = np.random.default_rng(seed)
        self.detectors = panel(seed)
        self.sets = feature_sets(campaign.features)
        self.scopes = scopes(campaign.features)
        self.folds = block_folds(campaign.features, seed)

    def score(self, scorer: Scorer, folds: Sequence[Fold]) -> HeldOut:
        self.progress(f"{scorer.detector}, {scorer.features}, {scorer.level}")
        detector, columns = self.detectors[scorer.detector], self.sets.get(scorer.features, [])
        return held_out(self.campaign, columns, detector, folds, scorer.level)

    def table(self, headline: HeldOut) -> pd.DataFrame:
        """Judge every scorer in every scope, the headline first."""
        rows = self._rows(HEADLINE, BLOCK, headline)
        for scorer in scorers(self.detectors, self.sets):
            if scorer != HEADLINE:
                rows += self._scored(scorer, BLOCK, self.folds)
        df = self.campaign.features
        rows += self._scored(HEADLINE, SESSION, session_folds(df, self.seed))
        for known in KNOWN:
            if folds := session_folds(df, self.seed, known):
                rows += self._scored(HEADLINE, f"{SESSION} but {known} blocks", folds)
        if is_hard_negative(df).any():
            rows += self._scored(HEADLINE, HARMLESS, untaught(df, self.folds))
        self.progress(f"{UPPER_BOUND}, with labels")
        classifier, columns = upper_bounds(self.seed)[UPPER_BOUND], self.sets.get("all", [])
        shown = supervised_scores(df, columns, classifier, self.folds)
        scores = HeldOut(shown, np.full_like(shown, np.nan), 0)
        rows += self._rows(Scorer(f"{UPPER_BOUND} (sees labels)", "all", "run"), BLOCK, scores)
        return pd.DataFrame(rows)

    def _scored(
        self, scorer: Scorer, split: str, folds: Sequence[Fold]
    ) -> list[dict[str, float | int | str]]:
        try:
            return self._rows(scorer, split, self.score(scorer, folds), tested_in(folds))
        except DetectorError as error:
            whole = self.scopes[0]
            row = unjudged(self.campaign, whole, str(error))
            return [{**scorer._asdict(), "split": split, "scope": whole.name, **row}]

    def _rows(
        self, scorer: Scorer, split: str, scores: HeldOut, tested: NDArray[np.bool_] | None = None
    ) -> list[dict[str, float | int | str]]:
        """Judge a scorer in every scope; of a split that tests some runs only, on those."""
        judged = self.scopes
        if tested is not None:
            judged = [Scope(scope.name, scope.runs & tested) for scope in judged]
        place = {**scorer._asdict(), "split": split}
        return [
            {**place, "scope": scope.name, **judge(scores, self.campaign, scope, self.rng)}
            for scope in judged
        ]

    def alarms(self) -> pd.DataFrame:
        """Judge the headline's detector window by window."""
        self.progress("alarms")
        columns, detector = self.sets.get(HEADLINE.features, []), self.detectors[HEADLINE.detector]
        raw = window_scores(self.campaign, columns, detector, self.folds)
        of_windows = [fold.of(self.campaign.run) for fold in self.folds]
        score = of_tested(standardised(raw, of_windows), of_windows)
        p = window_p(raw, self.campaign, self.folds)
        if calibration_runs(self.folds) < runs_needed(RATES[0]):
            p[:] = np.nan
        return pd.DataFrame(
            {"scope": scope.name, **judge_alarms(score, p, self.campaign, scope, self.rng)}
            for scope in self.scopes
        )

    def small_clusters(self) -> pd.DataFrame:
        """Judge the small-cluster protocol, all runs at once."""
        self.progress("small clusters")
        columns = self.sets.get(HEADLINE.features, [])
        try:
            return small_clusters_table(self.campaign.features, columns, self.rng)
        except ClusteringError as error:
            return pd.DataFrame([{"note": str(error)}])

    def checks(
        self, headline: HeldOut, table: pd.DataFrame, differences: Sequence[str] | None
    ) -> list[integrity.Check]:
        """Return all integrity checks of the headline."""
        self.progress("integrity checks")
        campaign, columns = self.campaign, self.sets.get(HEADLINE.features, [])
        detector = self.detectors[HEADLINE.detector]
        rng = np.random.default_rng([self.seed, 1])  # a further scorer above changes no check
        of_shortcuts = table[(table["features"] == "shortcuts") & (table["scope"] == ALL_MODES)]
        area = estimate(of_shortcuts.iloc[0], "auc") if len(of_shortcuts) else NOTHING
        return [
            integrity.same_between_sessions(headline, campaign, rng),
            integrity.equal_graphs(differences),
            integrity.label_above_session(campaign, columns, self.folds, self.seed),
            integrity.shuffled_labels(campaign, columns, detector, block_folds, rng),
            integrity.hard_negatives(headline, campaign, rng),
            integrity.shortcuts_apart(campaign.features, columns, area),
        ]

    def pictures(self, headline: HeldOut) -> dict[str, bytes]:
        """Draw ROC curves, detection over false alarms, and effort."""
        if not self._both_classes(self.scopes[0], headline):
            return {}
        self.progress("pictures")
        roc = {}
        for scope in filter(lambda scope: self._both_classes(scope, headline), self._shown()):
            runs = runs_of(self.campaign, scope.runs)
            score = headline.score[runs.first]
            roc[scope.name] = (roc_curve(score, runs, self.rng), auc(score, runs, self.rng))
        curve = effort_curve(headline.score, self.campaign.malicious)
        return {
            "roc": figures.roc_curves(roc),
            "detection": figures.curves(
                self._detection(headline), "nominal false-alarm rate", "share called anomalous",
                log=True,
            ),
            "effort": figures.curves(
                {"by score": Curve(*curve)}, "share of runs inspected", "share of attacks found"
            ),
        }  # fmt: skip

    def _shown(self) -> list[Scope]:
        """Return all modes, and each attack against its shadow or, without one, its control."""
        whole, *others = self.scopes
        pairs = [scope for scope in others if "/" in scope.name]
        against_right = [scope for scope in pairs if scope.name != " / ".join(OBSTACLE)]
        return [whole, *{scope.name.split(" / ")[1]: scope for scope in against_right}.values()]

    def _both_classes(self, scope: Scope, scores: HeldOut) -> bool:
        scored = scope.runs & np.isfinite(scores.score)
        return len(np.unique(self.campaign.malicious[scored])) == 2

    def _detection(self, headline: HeldOut) -> dict[str, Curve]:
        """Return for each attacked mode, and for right runs, the share of ``p <= alpha``."""
        rates = np.geomspace(1.0 / (headline.calibration + 1), 1.0, 40)
        modes, malicious = self.campaign.features["mode"].to_numpy(), self.campaign.malicious
        groups = {str(mode): modes == mode for mode in np.unique(modes[malicious])}
        return {
            name: self._shares(headline.p, members & np.isfinite(headline.p), rates)
            for name, members in {**groups, "right runs": ~malicious}.items()
        }

    def _shares(
        self, p: NDArray[np.float64], members: NDArray[np.bool_], rates: NDArray[np.float64]
    ) -> Curve:
        block = self.campaign.block[members]
        shares = [share(p[members] <= rate, block, self.rng) for rate in rates]
        y, low, high = (
            np.array([getattr(s, end) for s in shares]) for end in ("value", "low", "high")
        )
        return Curve(rates, y, low, high)


def _kill_pictures(kills: pd.DataFrame) -> dict[str, bytes]:
    """Draw a heat map and the headline detector's curves for each operator of the grid."""
    pictures = {}
    for (scenario, parameter), of in kills.groupby(["scenario", "parameter"], sort=False):
        pictures[f"kills_{scenario}_{parameter}"] = figures.kill_heat_map(of)
        shown = of[(of["detector"] == HEADLINE.detector) & (of["level"] == HEADLINE.level)]
        measures = ["value", "kill_rate", "kill_rate_low", "kill_rate_high"]
        lines = {
            figures.oracle_name(line.iloc[0]): Curve(*line[measures].to_numpy().T)
            for _, line in shown.groupby(["features", "split"], sort=False)
        }
        pictures[f"magnitude_{scenario}_{parameter}"] = figures.curves(
            lines, f"{parameter} of {scenario}", "detection rate", log=True
        )
    return pictures
