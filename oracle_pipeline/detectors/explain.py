"""Finds the features of a run that differ from those of normal runs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from oracle_pipeline.clustering.scaling import CLIP, FlooredRobustScaler
from oracle_pipeline.datasets import feature_floors, field_metadata

USUAL = (5.0, 95.0)  # percentiles of the normal runs that bound the usual range
LEAST_Z = 1.0  # smallest |z| of a deviation
KNOWN = 0.5  # share of the normal runs; nothing is outside the range of a feature that fewer have


class Deviation(NamedTuple):
    """One feature of a run compared with the normal runs; all but `z` in `unit`."""

    feature: str
    z: float  # robust, in the scaler's scales, clipped to `CLIP`
    capped: bool  # whether it is clipped
    value: float
    median: float  # of the normal runs, as are the percentiles
    usual_low: float
    usual_high: float
    unit: str


class FamilyDeviation(NamedTuple):
    """The number of features of one family that differ from those of normal runs."""

    family: str
    unusual: int
    compared: int
    feature: str  # the one with the largest |z|
    z: float
    capped: bool


class UsualRanges:
    """The usual values of each feature among some normal runs: range, median and scale.

    Parameters
    ----------
    normal : DataFrame
        Features of the runs to compare with.
    columns : sequence of str
        The features to compare.
    scaler : FlooredRobustScaler, optional
        Gives centre and scale; by default one with the declared floors.
    """

    def __init__(
        self,
        normal: pd.DataFrame,
        columns: Sequence[str],
        scaler: FlooredRobustScaler | None = None,
    ) -> None:
        scaler = scaler or FlooredRobustScaler(feature_floors(normal))
        self.scaler = scaler.fit(normal[list(columns)])
        values = normal[self.scaler.kept_].to_numpy(dtype=np.float64)
        values = np.where(np.isfinite(values), values, np.nan)
        gaps = np.isnan(values).mean(axis=0)
        self.low, self.high = np.percentile(values, USUAL, axis=0)
        some = (gaps > 0.0) & (gaps <= 1.0 - KNOWN)  # they take a hundred times as long
        if some.any():
            self.low[some], self.high[some] = np.nanpercentile(values[:, some], USUAL, axis=0)

    def deviations(self, row: pd.DataFrame) -> list[Deviation]:
        """Rank the features of one run that are outside their usual range, the farthest first.

        Features are compared one by one, independent of the detector. A run can also be unusual
        through a combination of features that are all usual.

        Parameters
        ----------
        row : DataFrame of one row
            Features that are NaN are left out.

        Returns
        -------
        list of Deviation
            Sorted by unclipped distance, the largest first.
        """
        scaler = self.scaler
        units = {feature: field.get("unit", "") for feature, field in field_metadata(row).items()}
        values = row[scaler.kept_].iloc[0].to_numpy(dtype=np.float64)
        distance = (values - scaler.center_) / scaler.scale_
        unusual = ((values < self.low) | (values > self.high)) & (np.abs(distance) >= LEAST_Z)
        found = np.flatnonzero(np.isfinite(values) & unusual)
        farthest = found[np.argsort(-np.abs(distance[found]), kind="stable")]
        return [
            Deviation(
                scaler.kept_[j], float(np.clip(distance[j], -CLIP, CLIP)),
                bool(abs(distance[j]) > CLIP), float(values[j]), float(scaler.center_[j]),
                float(self.low[j]), float(self.high[j]), units.get(scaler.kept_[j], ""),
            )
            for j in farthest.tolist()
        ]  # fmt: skip


def by_family(deviations: Sequence[Deviation], columns: Sequence[str]) -> list[FamilyDeviation]:
    """Summarise ranked deviations by family, the family with the farthest feature first."""
    families = [column.split(".", 1)[0] for column in columns]
    found: dict[str, list[Deviation]] = {}
    for deviation in deviations:
        found.setdefault(deviation.feature.split(".", 1)[0], []).append(deviation)
    return [
        FamilyDeviation(
            family, len(each), families.count(family), each[0].feature, each[0].z, each[0].capped
        )
        for family, each in found.items()
    ]
