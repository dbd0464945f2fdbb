"""Alarms during a run, as ``oracle score`` and the live monitor raise them.

The verdicts come from cards that do not know the run's block. This module compares the false alarms
per hour with the promised rate, and measures the delay of detection.
"""

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.evaluation.card_verdicts import CardVerdicts
from oracle_pipeline.evaluation.comparisons import ComparedRuns
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.metrics import events_per_hour, quantile, share
from oracle_pipeline.windows import WINDOW_S

# Features of windows are means and 95th percentiles over their messages.
LEAST_SHARE = 0.05


def times_to_detect(
    judged: CardVerdicts, campaign: JudgedRuns, since_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return seconds from an event to the end of the first window with an alarm, (n_runs,).

    An alarm counts if the attack takes at least `LEAST_SHARE` of its window, as less moves no
    feature. Infinite for a missed attack; NaN for a normal run.

    Parameters
    ----------
    judged : CardVerdicts
    campaign : JudgedRuns
    since_s : ndarray of shape (n_runs,)
        When the attack began, or first changed a message [s of the recording].
    """
    attacked = campaign.malicious
    first = np.where(attacked, np.inf, np.nan)
    for row, verdict in enumerate(judged.verdicts):
        alarms_s = [] if verdict is None else [alarm.time_s for alarm in verdict.alarms]
        late_s = np.array([time_s - since_s[row] for time_s in alarms_s])
        caused_s = late_s[late_s >= LEAST_SHARE * WINDOW_S]
        if attacked[row] and len(caused_s):
            first[row] = caused_s.min()
    return first


def judge_alarms(
    judged: CardVerdicts, campaign: JudgedRuns, scope: ComparedRuns, rng: np.random.Generator
) -> dict[str, float | int | str]:
    """Return the metrics of alarms in one scope as table columns, an estimate as three.

    ``behind_promise`` is the smallest number of normal runs that a promised rate was learned from;
    the realised rate is that of other normal runs.

    Parameters
    ----------
    judged : CardVerdicts
    campaign : JudgedRuns
    scope : ComparedRuns
    rng : Generator
        Draws the resamples for the intervals.
    """
    promises = np.array([_promise(judged, row) for row in range(len(judged.verdicts))])
    watched = scope.runs & np.isfinite(promises[:, 0])
    hit, normal = watched & campaign.malicious, watched & ~campaign.malicious
    late = times_to_detect(judged, campaign, campaign.onset_s)[hit]
    after_effect = times_to_detect(judged, campaign, campaign.effect_s)[hit]
    raised = np.array([0 if v is None else len(v.alarms) for v in judged.verdicts])[normal]
    lengths, block = campaign.truth["recording_s"].to_numpy(dtype=np.float64), campaign.block
    return {
        "attacked_runs": int(hit.sum()),
        "normal_runs": int(normal.sum()),
        **share(np.isinf(late), block[hit], rng).columns("missed"),
        **quantile(late, block[hit], 0.5, rng).columns("time_to_detect_median_s"),
        **quantile(late, block[hit], 0.9, rng).columns("time_to_detect_90_s"),
        **quantile(after_effect, block[hit], 0.5, rng).columns("after_effect_median_s"),
        "promised_per_h": float(promises[watched, 0].max()) if watched.any() else np.nan,
        "behind_promise": int(promises[watched, 1].min()) if watched.any() else 0,
        **events_per_hour(raised, lengths[normal], block[normal], rng).columns(
            "false_alarms_per_h"
        ),
    }


def _promise(judged: CardVerdicts, row: int) -> tuple[float, float]:
    """Return the promised rate of false alarms per hour, and the normal runs behind it."""
    verdict = judged.verdicts[row]
    if verdict is None or verdict.alarms_per_h is None:
        return np.nan, np.nan
    return verdict.alarms_per_h, verdict.normal_runs
