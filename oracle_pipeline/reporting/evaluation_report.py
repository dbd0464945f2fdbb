"""The oracle's evaluation as a `Report`: tables, pictures, and the headline as a sentence.

All values come from ``oracle_pipeline.evaluation.campaign_evaluation``.
"""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import KEYS, content_hash, is_malicious
from oracle_pipeline.evaluation import integrity_checks
from oracle_pipeline.evaluation.campaign_evaluation import CampaignEvaluation
from oracle_pipeline.evaluation.comparisons import HEADLINE, RATES
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.kill_rates import minimum_detectable, mutation_scores
from oracle_pipeline.evaluation.open_claims import as_table
from oracle_pipeline.evaluation.ranking import Ranking, standing
from oracle_pipeline.reporting import charts
from oracle_pipeline.reporting.stored_report import Report, facts
from oracle_pipeline.scoring.feature_sets import ASPECTS


def evaluation_report(evaluation: CampaignEvaluation) -> Report:
    """Return the report on an evaluation.

    The main table has a row for each scorer, split and comparison, the headline first. Further
    tables are ``alarms``, ``aspects``, ``aspects_by_mode``, ``task_uncertainty``,
    ``task_differences``, ``checks``, ``open_claims``, ``runs``, ``raised``, ``standing`` and, with
    a grid, ``kills``, ``mutation_scores`` and ``minimum_detectable``.
    """
    pictures = {"roc": charts.roc_curves(evaluation.curves)} if evaluation.curves else {}
    return Report(evaluation.table, pictures, _summary(evaluation), _tables(evaluation))


def _tables(evaluation: CampaignEvaluation) -> dict[str, pd.DataFrame]:
    kills = evaluation.kills
    runs = _judged(evaluation)
    tables = {
        "alarms": evaluation.alarms,
        **evaluation.aspects,
        "task_differences": evaluation.effects.differences.assign(run_id=runs["run_id"]),
        "checks": pd.DataFrame([check.columns() for check in evaluation.checks]),
        "open_claims": as_table(evaluation.open_claims),
        "runs": runs,
        "raised": _raised(evaluation),
        "standing": standing(runs),
    }
    if kills is not None:
        tables |= {
            "kills": kills,
            "mutation_scores": mutation_scores(kills),
            "minimum_detectable": minimum_detectable(kills),
        }
    return tables


def _judged(evaluation: CampaignEvaluation) -> pd.DataFrame:
    """Return a row for each run: its keys, its scores and p-values, and its outcome.

    ``score`` and ``p`` belong to the verdict; those of ``tampering`` and ``misbehaviour`` have
    their names as prefix. ``effect`` is the difference from unaltered runs of the block, in units
    of the uncertainty: above 1, the run misbehaved; NaN if unknown.
    """
    campaign, headline = evaluation.campaign, evaluation.headline
    aspects = {
        f"{aspect}_{name}": getattr(evaluation.aspect_scores.get(aspect), name, np.nan)
        for aspect in ASPECTS
        for name in ("score", "p")
    }
    features = campaign.features
    ended = ["recording_s", "onset_s", "outcome"]
    return features[[*KEYS]].assign(
        score=headline.score,
        p=headline.p,
        **aspects,
        effect=evaluation.effects.size,
        **{name: campaign.truth[name] for name in ended},
    )


def _raised(evaluation: CampaignEvaluation) -> pd.DataFrame:
    """Return a row for each alarm: its run, and the end of the window that raised it."""
    campaign, alarm = evaluation.campaign, evaluation.watched.alarm
    of_run = campaign.features["run_id"].to_numpy()[campaign.run[alarm]]
    return pd.DataFrame({"run_id": of_run, "at_s": campaign.end_s[alarm]})


def _summary(evaluation: CampaignEvaluation) -> dict[str, float | int | str]:
    campaign, first_row = evaluation.campaign, evaluation.table.iloc[0]
    area = Estimate.of_row(first_row, "auc")
    doubts = integrity_checks.banner(evaluation.checks)
    runs = _judged(evaluation)
    return {
        "headline": in_words(area) if _area_is_claimed(evaluation) else _ranked(Ranking.of(runs)),
        "verdicts": verdicts(runs),
        "banner": doubts,
        "scorer": f"{HEADLINE.detector} on {HEADLINE.features} features, level {HEADLINE.level}",
        "malicious_runs": int(campaign.malicious.sum()),
        "normal_runs": int((~campaign.malicious).sum()),
        "blocks": len(np.unique(campaign.block)),
        "left_out": evaluation.left_out,
        "seed": evaluation.seed,
        "content_hash": content_hash(campaign.features),
        **facts("auc", area),
        **facts("detection_rate_5", Estimate.of_row(first_row, "detection_rate_5")),
        **facts("false_alarm_rate_5", Estimate.of_row(first_row, "false_alarm_rate_5")),
    }


def _area_is_claimed(evaluation: CampaignEvaluation) -> bool:
    """Return whether there is an AUC and every integrity check is green."""
    return bool(np.isfinite(evaluation.table["auc"].iloc[0])) and not integrity_checks.banner(
        evaluation.checks
    )


def _ranked(ranking: Ranking) -> str:
    """Return a sentence on the rank of the attacked runs; it makes no claim on other runs.

    Examples
    --------
    >>> _ranked(Ranking(attacked=9, normal=9, on_top=9, by_chance=4.5))
    'All 9 attacked runs score higher than all 9 normal runs.'
    >>> _ranked(Ranking(attacked=9, normal=18, on_top=7, by_chance=3.0))
    'Of the 9 highest scores, 7 belong to the 9 attacked runs; by chance it would be about 3.'
    """
    if not ranking.attacked or not ranking.normal:
        return (
            "Nothing can be compared yet: a comparison needs attacked and normal runs with scores."
        )
    if ranking.on_top == ranking.attacked:
        return (
            f"All {ranking.attacked} attacked runs score higher than all {ranking.normal} "
            "normal runs."
        )
    return (
        f"Of the {ranking.attacked} highest scores, {ranking.on_top} belong to the "
        f"{ranking.attacked} attacked runs; by chance it would be about {ranking.by_chance:.0f}."
    )


def verdicts(runs: pd.DataFrame) -> str:
    """Return a sentence on the runs called anomalous at the usual rate; empty without p-values."""
    judged = runs[runs["p"].notna()]
    if judged.empty:
        return ""
    called, attacked = judged["p"] <= RATES[0], is_malicious(judged)
    return (
        f"At a nominal false positive rate of {RATES[0]:.0%}, {int(called[attacked].sum())} of "
        f"{attacked.sum()} attacked and {int(called[~attacked].sum())} of {(~attacked).sum()} "
        "normal runs are called anomalous."
    )


def in_words(area: Estimate) -> str:
    """Return the claim that an AUC with its interval supports.

    Examples
    --------
    >>> in_words(Estimate(0.55, 0.41, 0.68))
    'Attacked and normal runs cannot be distinguished: AUC 0.55 [0.41, 0.68] contains 0.5 (chance).'
    """
    if area.covers(0.5):
        return (
            f"Attacked and normal runs cannot be distinguished: AUC {area} contains 0.5 (chance)."
        )
    if area.high < 0.5:
        return f"Attacked runs look more usual than normal ones: AUC {area}, below chance."
    if area.low < 0.85:
        return f"Attacked runs stand out, but not reliably: AUC {area}, above chance."
    return f"Attacked runs stand out clearly: AUC {area}."
