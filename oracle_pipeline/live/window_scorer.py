"""The windows of a recording that goes on, judged by the scorer of a reference card as they end.

A card's p-value is that of a recording, whose most unusual windows stand for it. Here the last
``TOP_WINDOWS`` windows do. Their mean never exceeds that of the most unusual ones, so over a time
as long as the card's recordings an alarm is no more frequent than the p-value says.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
import pandas as pd

from oracle_pipeline.clustering.scaling import CLIP
from oracle_pipeline.datasets import WINDOW_START, field_metadata
from oracle_pipeline.detectors.explain import LEAST_Z
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.evidence import SHOWN
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import TOP_WINDOWS, top_windows
from oracle_pipeline.scoring.verdict import Evidence, ScoringError

_LEVEL = "windows"
_USUAL = 1.645  # scales from the median within which nine of ten values of a normal one are


@dataclass(frozen=True, slots=True)
class WindowVerdict:
    """The judgement of the last windows of a recording that goes on."""

    start_s: float  # of the newest window, since the start of the recording
    end_s: float
    score: float  # of that window; 0 is the median of normal recordings, 1 their spread
    p_value: float  # of the last windows together, among the normal recordings
    alarm: bool
    evidence: tuple[Evidence, ...] = ()  # what is farthest from usual in the newest window
    latency_s: float = 0.0  # from the end of the window to the verdict, by the wall


class WindowScorer:
    """Judges windows in order of time.

    Parameters
    ----------
    card : ReferenceCard
    far : float
        False positive rate: an alarm is a p-value that is not larger.

    Raises
    ------
    ScoringError
        If the card knows nothing of windows.
    """

    def __init__(self, card: ReferenceCard, far: float) -> None:
        self._scorer, self._far = card.scorer, far
        self.columns = list(card.scorer.design.window_features)
        if not self.columns:
            raise ScoringError(
                "The card holds no features of windows, so nothing can be judged before a "
                "recording has ended; learn it from recordings, or from tables with windows."
            )
        self._last: deque[pd.DataFrame] = deque(maxlen=TOP_WINDOWS)
        levels = list(self._scorer.scorers_[0].models_)
        self._centre = self._scorer.centre_[levels.index(_LEVEL)]
        self._spread = self._scorer.spread_[levels.index(_LEVEL)]

    def judge(self, row: pd.DataFrame, end_s: float) -> WindowVerdict:
        """Judge the last windows, of which a row of features is the newest."""
        start_s = float(row[WINDOW_START].iloc[0])
        self._last.append(row.reindex(columns=self.columns))
        windows = pd.concat(self._last, ignore_index=True)
        one = pd.DataFrame({"run_id": ["live"], "block": [-1]})
        runs = MeasuredRuns(one, windows, np.zeros(len(windows), dtype=np.intp))
        own = np.stack([scorer.score_windows(windows) for scorer in self._scorer.scorers_])
        means = np.stack([top_windows(scores, runs, TOP_WINDOWS) for scores in own])
        (p,) = self._scorer.p_values((means - self._centre) / self._spread)
        newest = float(np.median((own[:, -1] - self._centre) / self._spread))
        return WindowVerdict(
            start_s, end_s, newest, float(p), bool(p <= self._far), self._evidence(row)
        )

    def _evidence(self, row: pd.DataFrame) -> tuple[Evidence, ...]:
        """Return the features that are farthest from those of normal windows."""
        scaler = self._scorer.scorers_[0].models_[_LEVEL][0]
        values = row.reindex(columns=scaler.kept_).iloc[0].to_numpy(dtype=np.float64)
        z = np.nan_to_num((values - scaler.center_) / scaler.scale_, nan=0.0)
        units = {name: field.get("unit", "") for name, field in field_metadata(row).items()}
        farthest = np.argsort(-np.abs(z), kind="stable")[:SHOWN]
        return tuple(
            Evidence(
                feature=scaler.kept_[j],
                z=float(np.clip(z[j], -CLIP, CLIP)),
                capped=bool(abs(z[j]) > CLIP),
                value=float(values[j]),
                unit=units.get(scaler.kept_[j], ""),
                usual_low=float(scaler.center_[j] - _USUAL * scaler.scale_[j]),
                usual_high=float(scaler.center_[j] + _USUAL * scaler.scale_[j]),
                window_start_s=float(row[WINDOW_START].iloc[0]),
            )
            for j in farthest.tolist()
            if abs(z[j]) >= LEAST_Z
        )
