"""The runs that are judged: their features, windows and ground truth, in one order.

``oracle_pipeline.evaluation.held_out`` computes scores from features and windows; they are measured
against the ground truth.
"""

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import CHANGE_BIN_S
from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.windows import WINDOW_S


class EvaluationError(OracleError):
    """The tables of a campaign do not fit together."""


@dataclass(frozen=True, eq=False, slots=True)
class MeasuredRuns:
    """What is measured of distinct runs; n_runs and n_windows rows, each by ``run_id``.

    Attributes
    ----------
    features : DataFrame
        One row for each run.
    windows : DataFrame
        One row for each window, by start.
    run : ndarray of shape (n_windows,)
        Row of `features` that each window belongs to.
    """

    features: pd.DataFrame
    windows: pd.DataFrame
    run: NDArray[np.intp]

    @classmethod
    def ordered(cls, features: pd.DataFrame, windows: pd.DataFrame) -> "MeasuredRuns":
        """Put the tables in order; windows of other runs are left out.

        Raises
        ------
        CampaignError
            A run without windows.
        """
        _require_runs(features, windows, "window")
        runs = features.sort_values("run_id", ignore_index=True)
        number = pd.Series(np.arange(len(runs)), index=runs["run_id"])
        of_runs = windows[windows["run_id"].isin(number.index)]
        of_runs = of_runs.sort_values(["run_id", "window_start_s"], ignore_index=True)
        return cls(runs, of_runs, number.loc[of_runs["run_id"]].to_numpy(dtype=np.intp))

    def followed_by(self, others: "MeasuredRuns") -> "MeasuredRuns":
        """Return these runs and then others, with the columns of these."""
        return MeasuredRuns(
            _below(self.features, others.features),
            _below(self.windows, others.windows),
            np.concatenate([self.run, len(self.features) + others.run]),
        )

    @property
    def malicious(self) -> NDArray[np.bool_]:
        """Which runs were attacked, shape (n_runs,)."""
        return is_malicious(self.features)

    @property
    def block(self) -> NDArray[np.int64]:
        """Block of each run, shape (n_runs,)."""
        return self.features["block"].to_numpy(dtype=np.int64)

    @property
    def counts(self) -> NDArray[np.intp]:
        """How many windows each run has, shape (n_runs,)."""
        return np.bincount(self.run, minlength=len(self.features))

    @property
    def place(self) -> NDArray[np.intp]:
        """Which window of its run each is, from 0, shape (n_windows,)."""
        return np.arange(len(self.run)) - np.repeat(
            np.cumsum(self.counts) - self.counts, self.counts
        )

    @property
    def start_s(self) -> NDArray[np.float64]:
        """Start of each window [s of the recording], shape (n_windows,)."""
        return self.windows["window_start_s"].to_numpy(dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class JudgedRuns(MeasuredRuns):
    """Runs that are judged, and what really happened in them.

    Attributes
    ----------
    truth : DataFrame
        One row for each run (`truth.truth_table`).
    """

    truth: pd.DataFrame

    @classmethod
    def of(cls, features: pd.DataFrame, windows: pd.DataFrame, truth: pd.DataFrame) -> "JudgedRuns":
        """Put the tables in order; attacked runs that ended before their attack are left out.

        Raises
        ------
        CampaignError
            A run without windows or without a truth.
        """
        _require_runs(features, truth, "truth")
        truth_of_all = truth.set_index("run_id").loc[features["run_id"]]
        judged = ~is_malicious(features) | truth_of_all["onset_s"].notna().to_numpy()
        runs = MeasuredRuns.ordered(features[judged], windows)
        truth_of_runs = truth_of_all.loc[runs.features["run_id"]].reset_index()
        return cls(runs.features, runs.windows, runs.run, truth_of_runs)

    @property
    def end_s(self) -> NDArray[np.float64]:
        """End of each window [s of the recording], before which it cannot be judged."""
        recorded = self.truth["recording_s"].to_numpy(dtype=np.float64)[self.run]
        return np.asarray(np.minimum(self.start_s + WINDOW_S, recorded), dtype=np.float64)

    @property
    def onset_s(self) -> NDArray[np.float64]:
        """When each run's attack began [s of the recording], shape (n_runs,)."""
        return self.truth["onset_s"].to_numpy(dtype=np.float64)

    def attacked_windows(self) -> NDArray[np.bool_]:
        """Return the windows of attacked runs in which something was changed, (n_windows,).

        A run without a record of changes counts as changed from its onset on.
        """
        attacked = self.malicious[self.run] & (self.end_s > self.onset_s[self.run])
        for row in np.flatnonzero(self.malicious):
            bins = [start for start, *_ in json.loads(self.truth["changes"].iloc[row])]
            if bins:
                of_run = np.flatnonzero(self.run == row)
                start, end = self.start_s[of_run, None], self.end_s[of_run, None]
                overlap = (np.array(bins) < end) & (np.array(bins) + CHANGE_BIN_S > start)
                attacked[of_run] &= overlap.any(axis=1)
        return attacked


def _require_runs(features: pd.DataFrame, table: pd.DataFrame, name: str) -> None:
    absent = sorted(set(features["run_id"]) - set(table["run_id"]))
    if absent:
        raise EvaluationError(
            f"{len(absent)} runs, {absent[0]} the first, are not in the {name} table; "
            "materialize all tables again from the same runs."
        )


def _below(table: pd.DataFrame, others: pd.DataFrame) -> pd.DataFrame:
    joined = pd.concat([table, others.reindex(columns=table.columns)], ignore_index=True)
    joined.attrs = table.attrs
    return joined
