"""Scores of a run: by its features, by its signals, and by those of its most unusual windows.

These are levels with a score each. ``oracle_pipeline.scoring.cross_conformal`` combines them into
one score and a p-value. Features are known quantities; signals are the numbers of any robot. Those
count by their largest distance of any topic, by the distance over all topics, and by how far some,
and the farthest one alone, are beyond their range in normal runs.

A window also has a score of its own for alarms: how far its most unusual features are beyond what
normal windows reach. In a distance over all features, the few that a short attack changes are lost
among the many that it does not change. Signals count too where few features know the robot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.pipeline import Pipeline

from oracle_pipeline.clustering.scaling import CLIP
from oracle_pipeline.datasets import MINUS, topic_of_signal
from oracle_pipeline.detectors import BeyondRange, Detector, LargestGroup, SignalScaler, pipeline
from oracle_pipeline.features.signals.statistics import OF_WINDOW
from oracle_pipeline.scoring.measured_runs import MeasuredRuns, select_columns

OF_FEATURES = ("run", "windows")
BEYOND = {"range": 30, "farthest": 1}  # how many signals beyond their range count
WHOLE_SIGNALS = ("signals", "topics", *BEYOND)
OF_SIGNALS = (*WHOLE_SIGNALS, "signal windows")
_BY_TOPIC = ("topics", "signal windows")
PLAIN = "plain"  # level of a detector that a user named, alone
PLAIN_STATISTICS = ("mean", "std", "min", "max", "change")  # of signals, for it and for "range"
OF_WINDOWS = ("windows", "signal windows")  # levels of windows; all others are of whole runs
TOP_WINDOWS = 6  # number of highest window scores that are averaged for a run
TOP_FEATURES = 3  # number of a window's most unusual features that are averaged for alarms
ENOUGH_FEATURES = 100  # features of windows beside which signals raise no alarms
LEAST_REACH = 3.0  # smallest distance that normal windows are taken to reach [scales]
COMMON = 0.9  # share of the runs that reach the common length


@dataclass(frozen=True, slots=True)
class Design:
    """Features and detector of a scorer, fixed before any run is seen.

    Attributes
    ----------
    detector : Detector
        Unfitted; it is cloned.
    run_features, window_features : sequence of str
        Columns of the run table and of the window table. Either may be empty, but not both.
    floors : mapping of str to float
        Resolution of a column, in its unit.
    run_signals, window_signals : sequence of str
        Columns of signals, of both tables.
    levels : sequence of str
        Levels of the score, those without columns left out.
    named : str
        Name of the detector if a user chose it; it then scores alone.
    """

    detector: Detector
    run_features: Sequence[str]
    window_features: Sequence[str]
    floors: Mapping[str, float]
    run_signals: Sequence[str] = ()
    window_signals: Sequence[str] = ()
    levels: Sequence[str] = OF_FEATURES
    named: str = ""

    @property
    def uses_features(self) -> bool:
        """Whether features count, and not signals alone."""
        return any(level in OF_FEATURES for level in self.levels)

    @property
    def alarm_levels(self) -> tuple[str, ...]:
        """The levels of windows whose columns count for alarms."""
        are_known = len(self.window_features) >= ENOUGH_FEATURES
        levels = ("windows",) if are_known else OF_WINDOWS
        return tuple(filter(self.columns, levels)) if self.window_features else ()

    @property
    def run_columns(self) -> list[str]:
        """All columns of the run table."""
        return [*self.run_features, *self.run_signals]

    @property
    def window_columns(self) -> list[str]:
        """All columns of the window table."""
        return [*self.window_features, *self.window_signals]

    def columns(self, level: str) -> Sequence[str]:
        """Return the columns of a level."""
        if level in (PLAIN, *BEYOND):
            some = OF_WINDOW if level == "farthest" else PLAIN_STATISTICS  # extremes are chance
            of = [c for c in self.run_signals if c.rpartition(".")[2] in some]
            return [c for c in of if MINUS not in c] if level == PLAIN else of
        if level in OF_SIGNALS:
            return self.window_signals if level in OF_WINDOWS else self.run_signals
        return self.window_features if level in OF_WINDOWS else self.run_features


class NormalRange(NamedTuple):
    """What a column has in normal windows, in its unit."""

    low: float  # reached
    usual: float  # the median
    high: float  # reached


class RunScorer:
    """Scores runs by a model of normal runs; higher is more anomalous.

    Parameters
    ----------
    design : Design
    directions : int
        Those of `LargestGroup`.

    Attributes
    ----------
    models_ : dict of str to Pipeline
        A fitted scaler and detector for each level that has columns.
    reach_ : dict of str to ndarray of shape (n_columns,)
        For each level that counts for alarms: largest distance of each scaled column from 0 in the
        fitted runs, at least `LEAST_REACH` [scales].
    windows_counted_ : int
        Most windows of a fitted run. A longer run has more extreme windows by chance, so it counts
        by the mean over its parts of that length.
    """

    def __init__(self, design: Design, directions: int = 0) -> None:
        self.design = design
        self.directions = directions

    def fit(self, runs: MeasuredRuns) -> Self:
        """Learn what normal runs look like.

        Raises
        ------
        DetectorError
            The detector cannot be fitted on so few runs.
        """
        design = self.design
        self.windows_counted_ = int(runs.counts.max())
        self.models_: dict[str, Pipeline] = {}
        for level in dict.fromkeys((*design.levels, *design.alarm_levels)):
            if columns := design.columns(level):
                table = runs.windows if level in OF_WINDOWS else runs.features
                self.models_[level] = self._fitted(level, select_columns(table, columns))
        self.reach_ = {
            level: np.maximum(self._distances(level, runs.windows).max(axis=0), LEAST_REACH)
            for level in design.alarm_levels
        }
        return self

    def score(self, runs: MeasuredRuns) -> NDArray[np.float64]:
        """Return the scores of each run, shape (n_runs, n_levels), in the order of `levels`."""
        scores = []
        for level in self.levels:
            is_of_windows = level in OF_WINDOWS
            table = runs.windows if is_of_windows else runs.features
            seen = select_columns(table, self.design.columns(level))
            of_rows = -self.models_[level].score_samples(seen)
            if is_of_windows:
                of_rows = top_windows(of_rows, runs, self.windows_counted_)
            scores.append(of_rows)
        return np.column_stack(scores)

    @property
    def levels(self) -> tuple[str, ...]:
        """The levels that have columns, in order."""
        return tuple(level for level in self.design.levels if level in self.models_)

    @property
    def normal_in_windows(self) -> dict[str, NormalRange]:
        """The range of each column in normal windows; signals reach `LEAST_REACH` scales.

        It has no bounds where normal windows reach the largest distance that counts.
        """
        ranges: dict[str, NormalRange] = {}
        for level, model in self.models_.items():
            if level in OF_WINDOWS:
                scaler = model[0]
                of_features = level == "windows"
                reach = self.reach_[level][: len(scaler.kept_)] if of_features else LEAST_REACH
                reach = np.where(reach >= CLIP, np.inf, reach)
                spread = scaler.scale_ * np.where(getattr(scaler, "is_constant_", False), 0, reach)
                ends = zip(scaler.center_ - spread, scaler.center_, scaler.center_ + spread,
                           strict=True)  # fmt: skip
                of_level = (NormalRange(*map(float, each)) for each in ends)
                ranges |= dict(zip(scaler.kept_, of_level, strict=True))
        return ranges

    def alarm_scores(self, windows: pd.DataFrame) -> NDArray[np.float64]:
        """Return the score for alarms of each row of a window table, shape (n_windows,).

        It is the mean of the highest `TOP_FEATURES` distances, each divided by what normal windows
        reach. Above 1, these features are farther out than in any normal window.
        """
        highest = -np.sort(-self._beyond_reach(windows), axis=1)[:, :TOP_FEATURES]
        return np.asarray(highest.mean(axis=1), dtype=np.float64)

    def unusual_families(self, windows: pd.DataFrame) -> list[list[str]]:
        """Return the families beyond what normal windows reach, for each row, the farthest first.

        A window whose score is above 1 has at least one. The family of a signal is its topic.
        """
        scalers = [self.models_[level][0] for level in self.reach_]
        columns = [c for scaler in scalers for c in (*scaler.kept_, *scaler.indicated_)]
        names = np.array([topic_of_signal(c) or c.split(".", 1)[0] for c in columns])
        of_rows = self._beyond_reach(windows)
        order = np.argsort(-of_rows, axis=1, kind="stable")
        return [
            list(dict.fromkeys(names[own[row[own] > 1.0]].tolist()))
            for row, own in zip(of_rows, order, strict=True)
        ]

    def _fitted(self, level: str, table: pd.DataFrame) -> Pipeline:
        """Return the scaler and the detector of a level, fitted on a table with its columns."""
        if level in OF_FEATURES:
            return pipeline(clone(self.design.detector), self.design.floors).fit(table)
        scaler = SignalScaler(self.design.floors).fit(table)
        groups = [topic_of_signal(c) for c in scaler.kept_] if level in _BY_TOPIC else None
        detector: Detector = LargestGroup(groups, self.directions)
        if level in BEYOND:
            detector = BeyondRange(BEYOND[level])
        elif level == PLAIN:
            detector = clone(self.design.detector)
        return Pipeline([("scaler", scaler), ("detector", detector.fit(scaler.transform(table)))])

    def _beyond_reach(self, windows: pd.DataFrame) -> NDArray[np.float64]:
        """Return all distances by what normal windows reach, shape (n_windows, n_columns)."""
        return np.hstack(
            [self._distances(level, windows) / reach for level, reach in self.reach_.items()]
        )

    def _distances(self, level: str, windows: pd.DataFrame) -> NDArray[np.float64]:
        """Return the distances of the scaled columns from 0, shape (n_windows, n_columns)."""
        seen = select_columns(windows, self.design.columns(level))
        return np.asarray(np.abs(self.models_[level][0].transform(seen)), dtype=np.float64)


def top_windows(
    scores: NDArray[np.float64], runs: MeasuredRuns, windows_counted: int
) -> NDArray[np.float64]:
    """Return the mean of the highest window scores of each run, NaN without any; (n_runs,).

    Parameters
    ----------
    scores : ndarray of shape (n_windows,)
    runs : MeasuredRuns
        The runs of these windows.
    windows_counted : int
        Number of windows of a part. A run with more is split evenly into parts of about this
        number, and the mean over them counts.
    """
    counts = runs.counts
    parts = np.maximum(np.rint(counts / windows_counted).astype(np.intp), 1)
    first = np.cumsum(parts) - parts
    part = first[runs.run] + runs.place * parts[runs.run] // counts[runs.run]
    order = np.lexsort((-scores, part))
    sizes = np.bincount(part, minlength=int(parts.sum()))
    rank = np.arange(len(part)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    highest = order[rank < TOP_WINDOWS]
    total = np.bincount(part[highest], scores[highest], minlength=len(sizes))
    top = np.full(len(sizes), np.nan)
    np.divide(total, np.minimum(sizes, TOP_WINDOWS), out=top, where=sizes > 0)
    return np.asarray(np.add.reduceat(top, first) / parts, dtype=np.float64)


def common_length(windows: NDArray[np.intp]) -> int:
    """Return the number of windows that nine tenths of the runs reach.

    Examples
    --------
    >>> common_length(np.array([3, 9, 9, 9, 9, 9, 9, 9, 9, 10]))
    9
    """
    shorter = int(round(1.0 - COMMON, 9) * len(windows))
    return max(1, int(np.sort(windows)[shorter]))
