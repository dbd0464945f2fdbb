"""Alarms during a run: one verdict per window, time to detect, and false alarms per hour.

A window's p-value is its rank among the *oddest* windows of calibration runs: anywhere in a normal
run, ``p <= alpha`` is reached with a probability of about alpha.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.evaluation.comparisons import RATES, ComparedRuns
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import auc, events_per_hour, quantile, share
from oracle_pipeline.evaluation.splits import Fold
from oracle_pipeline.scoring.conformal import p_values
from oracle_pipeline.scoring.run_scorer import common_length


def window_p(
    scores: NDArray[np.float64], campaign: JudgedRuns, folds: Sequence[Fold]
) -> NDArray[np.float64]:
    """Return the p-value of each window of tested runs, shape (n_windows,).

    Parameters
    ----------
    scores : ndarray of shape (n_folds, n_windows)
        As of `scoring.window_scores`.
    campaign : Campaign
    folds : sequence of Fold
        Over runs.
    """
    counts, place = campaign.counts, campaign.place
    p = np.full(len(campaign.run), np.nan)
    for number, fold in enumerate(folds):
        common = np.isfinite(scores[number]) & (place < common_length(counts[fold.fit]))
        oddest = np.full(len(counts), -np.inf)
        np.maximum.at(oddest, campaign.run[common], scores[number, common])
        tested = fold.test[campaign.run] & np.isfinite(scores[number])
        calibration = oddest[fold.calibrate]
        p[tested] = p_values(calibration[np.isfinite(calibration)], scores[number, tested])
    return p


def times_to_detect(alarm: NDArray[np.bool_], campaign: JudgedRuns) -> NDArray[np.float64]:
    """Return seconds from the onset to the end of the first window with an alarm, (n_runs,).

    Windows that ended before the onset do not count. Infinite for an attack that is missed; NaN for
    a run without one.
    """
    onset = np.where(campaign.malicious, campaign.onset_s, np.nan)
    late = campaign.end_s - onset[campaign.run]
    first = np.where(campaign.malicious, np.inf, np.nan)
    counted = alarm & (late > 0.0)
    np.minimum.at(first, campaign.run[counted], late[counted])
    return first


def alarms_raised(alarm: NDArray[np.bool_], campaign: JudgedRuns) -> NDArray[np.int64]:
    """Return how often an alarm begins in each run, shape (n_runs,); neighbours are one alarm."""
    goes_on = np.append(False, alarm[:-1] & (campaign.run[1:] == campaign.run[:-1]))
    begun = campaign.run[alarm & ~goes_on]
    return np.bincount(begun, minlength=len(campaign.features))


def judge_alarms(
    score: NDArray[np.float64],
    p: NDArray[np.float64],
    campaign: JudgedRuns,
    scope: ComparedRuns,
    rng: np.random.Generator,
) -> dict[str, float | int | str]:
    """Return the figures of windows and alarms in one scope as table columns, an estimate as three.

    The AUC is of windows in which something was changed against windows of normal runs; those of
    attacked runs in which nothing was changed are left out, for what went before may still show.

    Parameters
    ----------
    score, p : ndarray of shape (n_windows,)
        Higher scores are more anomalous; NaN where not tested, or no verdict is supported.
    campaign : Campaign
    scope : Scope
    rng : Generator
        Draws the resamples behind the intervals.
    """
    scored, ranked = np.isfinite(score), np.isfinite(p)
    tested = np.isin(np.arange(len(campaign.features)), campaign.run[ranked])
    attacked, malicious = campaign.attacked_windows(), campaign.malicious
    compared = scope.runs[campaign.run] & scored & (attacked | ~malicious[campaign.run])
    first = np.flatnonzero(compared)
    windows = DistinctRuns(
        first,
        np.ones(len(first), dtype=np.int64),
        attacked[first],
        campaign.block[campaign.run[first]],
    )
    alarm = ranked & (p <= RATES[0])
    hit, normal = scope.runs & malicious & tested, scope.runs & ~malicious & tested
    late, raised = times_to_detect(alarm, campaign)[hit], alarms_raised(alarm, campaign)[normal]
    lengths, block = campaign.truth["recording_s"].to_numpy(dtype=np.float64), campaign.block
    return {
        "attacked_windows": int(windows.malicious.sum()),
        "normal_windows": int((~windows.malicious).sum()),
        **auc(score[first], windows, rng).columns("auc"),
        "attacked_runs": int(hit.sum()),
        **share(np.isinf(late), block[hit], rng).columns("missed"),
        **quantile(late, block[hit], 0.5, rng).columns("time_to_detect_median_s"),
        **quantile(late, block[hit], 0.9, rng).columns("time_to_detect_90_s"),
        **events_per_hour(raised, lengths[normal], block[normal], rng).columns(
            "false_alarms_per_h"
        ),
    }
