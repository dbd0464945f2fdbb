"""The features of runs and of their windows, sorted consistently."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import MISSING, WHERE, DatasetError, is_malicious


@dataclass(frozen=True, eq=False, slots=True)
class MeasuredRuns:
    """Features of distinct runs; n_runs and n_windows rows, sorted by ``run_id``.

    Attributes
    ----------
    features : DataFrame
        One row for each run.
    windows : DataFrame
        One row per window, sorted by start; without the text columns on where features were
        attained and why they are missing.
    run : ndarray of shape (n_windows,)
        Row of `features` that each window belongs to.
    """

    features: pd.DataFrame
    windows: pd.DataFrame
    run: NDArray[np.intp]

    @classmethod
    def ordered(cls, features: pd.DataFrame, windows: pd.DataFrame) -> "MeasuredRuns":
        """Sort the tables; windows of other runs are dropped.

        Raises
        ------
        DatasetError
            A run without windows.
        """
        require_runs(features, windows, "window")
        runs = features.sort_values("run_id", ignore_index=True)
        number = pd.Series(np.arange(len(runs)), index=runs["run_id"])
        numbers = windows.drop(columns=[WHERE, MISSING], errors="ignore")
        of_runs = numbers[windows["run_id"].isin(number.index)]
        of_runs = of_runs.sort_values(["run_id", "window_start_s"], ignore_index=True)
        return cls(runs, of_runs, number.loc[of_runs["run_id"]].to_numpy(dtype=np.intp))

    def with_columns(self, of_runs: Sequence[str], of_windows: Sequence[str]) -> "MeasuredRuns":
        """Return the runs with only the named features, and their windows without keys.

        Selecting runs then copies less.
        """
        keys = [column for column in self.features.columns if "." not in column]
        features = select_columns(self.features, [*keys, *of_runs])
        return MeasuredRuns(features, select_columns(self.windows, of_windows), self.run)

    def where(self, chosen: NDArray[np.bool_]) -> "MeasuredRuns":
        """Return the runs of a mask of shape (n_runs,), with their windows."""
        kept = chosen[self.run]
        number = np.cumsum(chosen) - 1
        features, windows = self.features[chosen], self.windows[kept]
        return MeasuredRuns(
            features.reset_index(drop=True),
            windows.reset_index(drop=True),
            number[self.run[kept]].astype(np.intp),
        )

    def concat(self, others: "MeasuredRuns") -> "MeasuredRuns":
        """Return these runs followed by others, which get the columns of these."""
        return MeasuredRuns(
            _concat(self.features, others.features),
            _concat(self.windows, others.windows),
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
    def session(self) -> NDArray[np.int64]:
        """Session of each run, shape (n_runs,); its block if the table has no sessions."""
        if "session" not in self.features:
            return self.block
        return self.features["session"].to_numpy(dtype=np.int64)

    @property
    def counts(self) -> NDArray[np.intp]:
        """Number of windows of each run, shape (n_runs,)."""
        return np.bincount(self.run, minlength=len(self.features))

    @property
    def place(self) -> NDArray[np.intp]:
        """Index of each window within its run, from 0, shape (n_windows,)."""
        return np.arange(len(self.run)) - np.repeat(
            np.cumsum(self.counts) - self.counts, self.counts
        )

    @property
    def start_s(self) -> NDArray[np.float64]:
        """Start of each window [s of the recording], shape (n_windows,)."""
        return self.windows["window_start_s"].to_numpy(dtype=np.float64)


def require_runs(features: pd.DataFrame, table: pd.DataFrame, name: str) -> None:
    """Raise an error if a table lacks some of the runs; `name` is used in the message."""
    absent = sorted(set(features["run_id"]) - set(table["run_id"]))
    if absent:
        raise DatasetError(
            f"{len(absent)} runs, {absent[0]} the first, are not in the {name} table; "
            "materialize all tables again from the same runs."
        )


def select_columns(table: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """Return some columns of a table, with names that are looked up fast."""
    names = pd.Index(list(columns), dtype=object)  # Arrow makes strings anew for each look
    found = table[names]
    found.columns = names
    return found


def _concat(table: pd.DataFrame, others: pd.DataFrame) -> pd.DataFrame:
    joined = pd.concat([table, others.reindex(columns=table.columns)], ignore_index=True)
    joined.attrs = table.attrs
    return joined
