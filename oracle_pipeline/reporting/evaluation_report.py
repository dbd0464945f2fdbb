"""The oracle's evaluation as a `Report`: tables, and the headline as a sentence.

All values come from ``oracle_pipeline.evaluation.campaign_evaluation``.
"""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import KEYS, content_hash, is_malicious
from oracle_pipeline.evaluation.campaign_evaluation import CampaignEvaluation
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.kill_rates import MAGNITUDE, kill_rates, minimum_detectable
from oracle_pipeline.evaluation.ranking import Ranking, standing
from oracle_pipeline.reporting.stored_report import Report, facts
from oracle_pipeline.scoring.feature_sets import ASPECTS

EXIT_RATES = ("exit_detection_rate", "exit_false_positive_rate")
FIGURES = (*EXIT_RATES, "detection_rate", "false_positive_rate", "auc")  # of the first row


def evaluation_report(evaluation: CampaignEvaluation) -> Report:
    """Return the report on an evaluation.

    The main table has a row for each detector, split and comparison, the headline first. Further
    tables are ``alarms``, ``aspects``, ``task_uncertainty``, ``task_differences``, ``checks``,
    ``open_claims``, ``runs``, ``raised``, ``standing`` and, with a grid, ``kills``,
    ``mutation_scores`` and ``minimum_detectable``.
    """
    return Report(evaluation.table, _summary(evaluation), _tables(evaluation))


def _tables(evaluation: CampaignEvaluation) -> dict[str, pd.DataFrame]:
    rng = np.random.default_rng(evaluation.seed)
    runs = _judged(evaluation)
    tables = {
        "alarms": evaluation.alarms,
        **evaluation.aspects,
        "task_differences": evaluation.effects.differences.assign(run_id=runs["run_id"]),
        "checks": pd.DataFrame([check.columns() for check in evaluation.checks]),
        "open_claims": evaluation.open_claims,
        "runs": runs,
        "raised": _raised(evaluation),
        "standing": standing(runs),
    }
    if evaluation.kills is not None:
        kills = kill_rates(evaluation.kills, MAGNITUDE, rng)
        tables |= {
            "kills": kills,
            "mutation_scores": kill_rates(evaluation.kills, ["split"], rng),
            "minimum_detectable": minimum_detectable(kills),
        }
    return tables


def _judged(evaluation: CampaignEvaluation) -> pd.DataFrame:
    """Return a row for each run: its keys, its scores and p-values, exit code and outcome.

    ``score``, ``p`` and ``exit`` belong to the verdict; ``tampering`` and ``misbehaviour`` have
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
        exit=evaluation.verdicts.exits(),
        **aspects,
        effect=evaluation.effects.size,
        **{name: campaign.truth[name] for name in ended},
    )


def _raised(evaluation: CampaignEvaluation) -> pd.DataFrame:
    """Return a row for each alarm: its run, and the end of the window that raised it."""
    judged = [verdict for verdict in evaluation.verdicts.verdicts if verdict is not None]
    rows = [(verdict.recording, alarm.time_s) for verdict in judged for alarm in verdict.alarms]
    return pd.DataFrame(rows, columns=["run_id", "at_s"])


def _summary(evaluation: CampaignEvaluation) -> dict[str, float | int | str]:
    campaign, first_row = evaluation.campaign, evaluation.table.iloc[0]
    figures = {name: Estimate.of_row(first_row, name) for name in FIGURES}
    rates = [figures[name] for name in EXIT_RATES]
    runs = _judged(evaluation)
    claimed = all(np.isfinite(rate.value) for rate in rates) and not any(
        check.status == "red" for check in evaluation.checks
    )
    return {
        "headline": in_words(*rates) if claimed else _ranked(Ranking.of(runs)),
        "verdicts": verdicts(runs),
        "scorer": "reference cards of other blocks, as oracle score uses them",
        "malicious_runs": int(campaign.malicious.sum()),
        "normal_runs": int((~campaign.malicious).sum()),
        "blocks": len(np.unique(campaign.block)),
        "left_out": evaluation.left_out,
        "seed": evaluation.seed,
        "content_hash": content_hash(campaign.features),
        **{key: value for name, of in figures.items() for key, value in facts(name, of).items()},
    }


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
    """Return sentences on the runs that the verdicts call wrong; empty without verdicts."""
    judged = runs[runs["exit"].notna()]
    if judged.empty:
        return ""
    attacked = is_malicious(judged)
    by_exit, by_features = (
        f"{int(called[attacked].sum())} of {attacked.sum()} attacked and "
        f"{int(called[~attacked].sum())} of {(~attacked).sum()} normal runs"
        for called in (judged["exit"] == 1.0, judged["p"] <= RATE)
    )
    return (
        f"At a nominal false positive rate of {RATE:.0%}, the exit code is 1 for {by_exit}. By "
        f"features alone, {by_features} are anomalous."
    )


def in_words(detected: Estimate, false: Estimate) -> str:
    """Return the headline: how often users get exit code 1.

    Examples
    --------
    >>> in_words(Estimate(0.97, 0.92, 0.99), Estimate(0.04, 0.02, 0.08))
    'Exit code 1 for 0.97 [0.92, 0.99] of attacked and 0.04 [0.02, 0.08] of normal runs.'
    """
    return f"Exit code 1 for {detected} of attacked and {false} of normal runs."
