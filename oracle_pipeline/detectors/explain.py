"""Which features of a run are unlike those of normal runs, and by how much."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from oracle_pipeline.datasets import field_metadata


class Deviation(NamedTuple):
    """One feature of a run beside the normal runs; value and median in `unit`."""

    feature: str
    z: float  # robust, in the scaler's scales
    value: float
    median: float  # of the normal runs
    unit: str


def explain(pipeline: Pipeline, row: pd.DataFrame) -> list[Deviation]:
    """Rank the features of one run by their distance from the median of normal runs.

    Each feature is looked at alone, whatever the detector; a run can be odd by a combination of
    which no part is.

    Parameters
    ----------
    pipeline : Pipeline
        Fitted, its first step a `FlooredRobustScaler`.
    row : DataFrame of one row
        Features that are NaN are left out.

    Returns
    -------
    list of Deviation
        Largest ``abs(z)`` first.
    """
    scaler = pipeline[0]
    units = {feature: field.get("unit", "") for feature, field in field_metadata(row).items()}
    z = scaler.transform(row)[0, : len(scaler.kept_)]
    values = row[scaler.kept_].iloc[0]
    deviations = [
        Deviation(feature, float(z_j), float(value), float(median), units.get(feature, ""))
        for feature, z_j, value, median in zip(scaler.kept_, z, values, scaler.center_, strict=True)
        if np.isfinite(value)
    ]
    return sorted(deviations, key=lambda deviation: -abs(deviation.z))
