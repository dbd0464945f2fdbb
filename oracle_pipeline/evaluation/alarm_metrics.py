"""Alarms during a run, as ``oracle score`` and the live monitor raise them.

Each run is processed window by window, with the headline's scorer and a threshold, neither of which
was learned from the run's block (``oracle_pipeline.scoring.alarms``). This module compares the
false alarms per hour with the promised rate, and measures the delay of detection.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.evaluation.comparisons import ComparedRuns
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, events_per_hour, quantile, share
from oracle_pipeline.scoring.alarms import RATE_PER_H, AlarmWatch
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer


@dataclass(frozen=True, eq=False, slots=True)
class WatchedRuns:
    """Scores and alarms of the runs of a campaign; arrays of shape (n_windows,).

    Attributes
    ----------
    score : ndarray
        Score of each window; NaN if there are too few blocks to learn from.
    alarm : ndarray of bool
        Whether the window raised an alarm.
    per_hour : float
        Promised upper bound on false alarms per hour; NaN without scores.
    """

    score: NDArray[np.float64]
    alarm: NDArray[np.bool_]
    per_hour: float


def watched(campaign: JudgedRuns, scorer: CrossConformalScorer | None) -> WatchedRuns:
    """Return the alarms of a campaign, at `RATE_PER_H` or the lowest rate that it supports.

    Parameters
    ----------
    campaign : JudgedRuns
    scorer : CrossConformalScorer or None
        Learned from the normal runs; None if there are too few or they have no feature.
    """
    score, alarm = np.full(len(campaign.run), np.nan), np.zeros(len(campaign.run), dtype=np.bool_)
    if scorer is None or scorer.windows_ is None:
        return WatchedRuns(score, alarm, np.nan)
    block, ends_s = campaign.block[campaign.run], campaign.end_s
    score[:] = scorer.window_scores(campaign.windows, block)
    families = scorer.window_families(campaign.windows)
    promised = []
    for name in np.unique(block):
        normal = scorer.windows_.without(name)
        rule = normal.rule(max(RATE_PER_H, normal.lowest_rate()))
        promised.append(rule.per_hour)
        of_block = np.flatnonzero(block == name)
        for run in np.unique(campaign.run[of_block]):
            watch = AlarmWatch(rule)
            for window in of_block[campaign.run[of_block] == run].tolist():
                fed = float(ends_s[window]), float(score[window]), families[window]
                alarm[window] = watch.feed(*fed) is not None
    return WatchedRuns(score, alarm, max(promised))


def times_to_detect(
    alarm: NDArray[np.bool_], campaign: JudgedRuns, since_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return seconds from an event to the end of the first window with an alarm, (n_runs,).

    Windows that ended before the event do not count. Infinite for a missed attack; NaN for a normal
    run.

    Parameters
    ----------
    alarm : ndarray of bool, shape (n_windows,)
    campaign : JudgedRuns
    since_s : ndarray of shape (n_runs,)
        When the attack began, or first changed a message [s of the recording].
    """
    late = campaign.end_s - since_s[campaign.run]
    first = np.where(campaign.malicious, np.inf, np.nan)
    counted = alarm & (late > 0.0) & campaign.malicious[campaign.run]
    np.minimum.at(first, campaign.run[counted], late[counted])
    return first


def judge_alarms(
    watched_runs: WatchedRuns,
    campaign: JudgedRuns,
    scope: ComparedRuns,
    rng: np.random.Generator,
) -> dict[str, float | int | str]:
    """Return the metrics of windows and alarms in one scope as table columns, an estimate as three.

    The AUC compares windows with altered messages with windows of normal runs. Other windows of
    attacked runs are left out, because an earlier change may still have an effect there.

    Parameters
    ----------
    watched_runs : WatchedRuns
    campaign : JudgedRuns
    scope : ComparedRuns
    rng : Generator
        Draws the resamples for the intervals.
    """
    score, alarm = watched_runs.score, watched_runs.alarm
    scored = np.isfinite(score)
    judged = scope.runs & np.isfinite(watched_runs.per_hour)
    attacked, malicious = campaign.attacked_windows(), campaign.malicious
    compared = scope.runs[campaign.run] & scored & (attacked | ~malicious[campaign.run])
    windows = DistinctRuns.once(compared, attacked, campaign.block[campaign.run])
    hit, normal = judged & malicious, judged & ~malicious
    late = times_to_detect(alarm, campaign, campaign.onset_s)[hit]
    after_effect = times_to_detect(alarm, campaign, campaign.effect_s)[hit]
    raised = np.bincount(campaign.run[alarm], minlength=len(malicious))[normal]
    lengths, block = campaign.truth["recording_s"].to_numpy(dtype=np.float64), campaign.block
    return {
        "attacked_windows": int(windows.malicious.sum()),
        "normal_windows": int((~windows.malicious).sum()),
        **auc(score[windows.first], windows, rng).columns("auc"),
        "attacked_runs": int(hit.sum()),
        "normal_runs": int(normal.sum()),
        **share(np.isinf(late), block[hit], rng).columns("missed"),
        **quantile(late, block[hit], 0.5, rng).columns("time_to_detect_median_s"),
        **quantile(late, block[hit], 0.9, rng).columns("time_to_detect_90_s"),
        **quantile(after_effect, block[hit], 0.5, rng).columns("after_effect_median_s"),
        "promised_per_h": watched_runs.per_hour,
        **events_per_hour(raised, lengths[normal], block[normal], rng).columns(
            "false_alarms_per_h"
        ),
    }
