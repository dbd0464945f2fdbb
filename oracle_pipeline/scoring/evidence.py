"""The features of a recording that are farthest from normal runs, with place and time."""

import json
from collections.abc import Sequence

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import WHERE, WINDOW_START, topic_of_signal
from oracle_pipeline.detectors import Deviation, explain
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.comparable import comparable
from oracle_pipeline.scoring.verdict import Evidence, ScoringError

SHOWN = 5  # features listed with a verdict


def evidence(tables: FeatureTables, reference: pd.DataFrame) -> tuple[Evidence, ...]:
    """Return the features of one recording that are farthest from normal runs, without a verdict.

    If the recording is part of the reference, its block is left out.

    Raises
    ------
    OracleError
        The reference has no normal run of another block, or shares no feature with the recording.
    """
    columns, normal_runs, _ = comparable(tables.run, reference)
    if normal_runs.empty:
        raise ScoringError("There is no normal run of another block to compare with; record some.")
    return farthest_features(explain(normal_runs, tables.run, columns), tables)


def farthest_features(
    deviations: Sequence[Deviation], tables: FeatureTables
) -> tuple[Evidence, ...]:
    """Return the first few of a recording's ranked deviations, with place and time."""
    where = json.loads(tables.run[WHERE].iloc[0])
    return tuple(
        Evidence(
            feature=deviation.feature,
            z=deviation.z,
            capped=deviation.capped,
            value=deviation.value,
            unit=deviation.unit,
            usual_low=deviation.usual_low,
            usual_high=deviation.usual_high,
            where=where.get(deviation.feature) or topic_of_signal(deviation.feature) or None,
            window_start_s=_farthest_window(deviation, tables.windows),
        )
        for deviation in deviations[:SHOWN]
    )


def _farthest_window(deviation: Deviation, windows: pd.DataFrame) -> float | None:
    """Return the start of the window that deviates most in the direction of the whole run [s].

    None if the feature has no values by window, or all are equal.
    """
    if deviation.feature not in windows.columns or windows[deviation.feature].nunique() < 2:
        return None
    farthest = np.nanargmax(np.sign(deviation.z) * windows[deviation.feature].to_numpy())
    return float(windows[WINDOW_START].to_numpy()[farthest])
