"""The runs that are judged: features, windows and ground truth, sorted consistently.

``oracle_pipeline.evaluation.held_out`` computes scores from features and windows, which are then
compared with the ground truth.
"""

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.scoring.measured_runs import MeasuredRuns, require_runs


@dataclass(frozen=True, eq=False, slots=True)
class JudgedRuns(MeasuredRuns):
    """Runs that are judged, with their ground truth.

    Attributes
    ----------
    truth : DataFrame
        One row for each run (`truth.truth_table`).
    """

    truth: pd.DataFrame

    @classmethod
    def of(cls, features: pd.DataFrame, windows: pd.DataFrame, truth: pd.DataFrame) -> "JudgedRuns":
        """Sort the tables; attacked runs that ended before their attack are dropped.

        Raises
        ------
        DatasetError
            A run without windows or without ground truth.
        """
        require_runs(features, truth, "truth")
        truth_of_all = truth.set_index("run_id").loc[features["run_id"]]
        judged = ~is_malicious(features) | truth_of_all["onset_s"].notna().to_numpy()
        runs = MeasuredRuns.ordered(features[judged], windows)
        truth_of_runs = truth_of_all.loc[runs.features["run_id"]].reset_index()
        return cls(runs.features, runs.windows, runs.run, truth_of_runs)

    @property
    def onset_s(self) -> NDArray[np.float64]:
        """When each run's attack began [s of the recording], shape (n_runs,)."""
        return self.truth["onset_s"].to_numpy(dtype=np.float64)

    @property
    def effect_s(self) -> NDArray[np.float64]:
        """When each run's attack first changed a message [s of the recording], shape (n_runs,).

        Changes are recorded in bins of 5 s; this is the start of the first. Without any, it is the
        onset.
        """
        first = [
            min((start for start, *_ in json.loads(text)), default=0.0)
            for text in self.truth["changes"]
        ]
        return np.asarray(np.maximum(self.onset_s, first), dtype=np.float64)
