"""Judges the windows of a recording in progress by a reference card, as they end.

Scores and alarm rule are those of the card, so ``oracle score`` raises the same alarms on the
finished recording.
"""

import numpy as np
import pandas as pd

from oracle_pipeline.clustering.scaling import CLIP
from oracle_pipeline.datasets import WINDOW_START, field_metadata
from oracle_pipeline.detectors.explain import LEAST_Z
from oracle_pipeline.live.events import WindowVerdict
from oracle_pipeline.scoring.alarms import RATE_PER_H, AlarmWatch
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.evidence import SHOWN
from oracle_pipeline.scoring.verdict import Evidence, ScoringError

_USUAL = 1.645  # scales around the median that hold 90 % of a normal distribution


class WindowScorer:
    """Judges windows; what came before them is in an `AlarmWatch` by its rule.

    Parameters
    ----------
    card : ReferenceCard
    alarms_per_h : float, optional
        False alarms an hour that may be raised; by default ``RATE_PER_H``, or the lowest rate that
        the card supports.

    Attributes
    ----------
    alarms_per_h : float
        The rate that is promised.
    rule : AlarmRule
        For that rate.
    uses_signals : bool
        Whether signals count, since few features know the robot.

    Raises
    ------
    ScoringError
        If the card holds no features of windows.
    AlarmError
        If it has too few hours of normal recordings for the rate.
    """

    def __init__(self, card: ReferenceCard, alarms_per_h: float | None = None) -> None:
        normal = card.scorer.windows_
        if normal is None:
            raise ScoringError(
                "The card holds no features of windows, so nothing can be judged before a "
                "recording has ended; learn it from recordings, or from tables with windows."
            )
        self._scorer = card.scorer
        self._models = card.scorer.scorers_[0]
        self.uses_signals = "signal windows" in self._models.reach_
        self._normal = np.sort(normal.scores)
        self.alarms_per_h = alarms_per_h or max(RATE_PER_H, normal.lowest_rate())
        self.rule = normal.rule(self.alarms_per_h)

    def judge(self, row: pd.DataFrame, end_s: float, alarms: AlarmWatch) -> WindowVerdict:
        """Judge a robot's next window by its row of features."""
        score = float(self._scorer.window_scores(row)[0])
        higher = len(self._normal) - int(np.searchsorted(self._normal, score))
        return WindowVerdict(
            start_s=float(row[WINDOW_START].iloc[0]),
            end_s=end_s,
            score=score,
            p_value=(1 + higher) / (1 + len(self._normal)),
            is_usual=score <= self.rule.allowance,
            alarm=alarms.feed(end_s, score, self._scorer.window_families(row)[0]) is not None,
            evidence=self._evidence(row),
            alarm_score=self.rule.allowance + self.rule.threshold * self.rule.reach[0],
        )

    def _evidence(self, row: pd.DataFrame) -> tuple[Evidence, ...]:
        """Return the features that are farthest from those of normal windows."""
        scalers = [self._models.models_[level][0] for level in self._models.reach_]
        kept = [column for scaler in scalers for column in scaler.kept_]
        center = np.concatenate([scaler.center_ for scaler in scalers])
        scale = np.concatenate([scaler.scale_ for scaler in scalers])
        values = row.reindex(columns=kept).iloc[0].to_numpy(dtype=np.float64)
        z = np.nan_to_num((values - center) / scale, nan=0.0)
        units = {name: field.get("unit", "") for name, field in field_metadata(row).items()}
        farthest = np.argsort(-np.abs(z), kind="stable")[:SHOWN]
        return tuple(
            Evidence(
                feature=kept[j],
                z=float(np.clip(z[j], -CLIP, CLIP)),
                capped=bool(abs(z[j]) > CLIP),
                value=float(values[j]),
                unit=units.get(kept[j], ""),
                usual_low=float(center[j] - _USUAL * scale[j]),
                usual_high=float(center[j] + _USUAL * scale[j]),
                window_start_s=float(row[WINDOW_START].iloc[0]),
            )
            for j in farthest.tolist()
            if abs(z[j]) >= LEAST_Z
        )
