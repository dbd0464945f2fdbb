"""The features of a recording that are farthest from normal runs, with place and time."""

import json

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from oracle_pipeline.datasets import WHERE, WINDOW_START, feature_floors
from oracle_pipeline.detectors import DEFAULT_DETECTOR, Deviation, explain, panel, pipeline
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.comparable import comparable
from oracle_pipeline.scoring.verdict import Evidence, ScoringError

SEED = 0  # of detectors that draw
SHOWN = 5  # features beside a verdict
USUAL = (5.0, 95.0)  # percentiles of the normal runs between which a value is usual


def evidence(tables: FeatureTables, reference: pd.DataFrame) -> tuple[Evidence, ...]:
    """Return the features of one recording that are farthest from normal runs, without a verdict.

    If the recording is one of the reference, its block takes no part.

    Raises
    ------
    OracleError
        The reference has no normal run of another block, or shares no feature with the recording.
    """
    columns, normal_runs, _ = comparable(tables.run, reference)
    if normal_runs.empty:
        raise ScoringError("There is no normal run of another block to compare with; record some.")
    oracle = pipeline(panel(SEED)[DEFAULT_DETECTOR], feature_floors(reference))
    oracle[0].fit(normal_runs[columns])
    return farthest_features(oracle, tables, normal_runs)


def farthest_features(
    oracle: Pipeline, tables: FeatureTables, normal_runs: pd.DataFrame
) -> tuple[Evidence, ...]:
    """Return the features that are farthest from normal, by the fitted scaler of an oracle."""
    deviations = explain(oracle, tables.run)[:SHOWN]
    where = json.loads(tables.run[WHERE].iloc[0])
    return tuple(
        Evidence(
            feature=deviation.feature,
            z=deviation.z,
            value=deviation.value,
            unit=deviation.unit,
            usual_low=float(low),
            usual_high=float(high),
            where=where.get(deviation.feature),
            window_start_s=_farthest_window(deviation, tables.windows),
        )
        for deviation in deviations
        for low, high in [np.nanpercentile(normal_runs[deviation.feature], USUAL)]
    )


def _farthest_window(deviation: Deviation, windows: pd.DataFrame) -> float | None:
    """Return the start of the window that is farthest out in the direction of the whole run [s].

    None if the feature has no values by window, or they are all the same.
    """
    if deviation.feature not in windows.columns or windows[deviation.feature].nunique() < 2:
        return None
    farthest = np.nanargmax(np.sign(deviation.z) * windows[deviation.feature].to_numpy())
    return float(windows[WINDOW_START].to_numpy()[farthest])
