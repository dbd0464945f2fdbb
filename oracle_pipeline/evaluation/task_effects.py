"""The effect of an attack on the robot's task, and whether it exceeds chance.

The runs of a block have the same start and goals. Each is compared with the unaltered runs of its
block (passthroughs and shadow controls) under the same conditions: a robot that has to drive slowly
does not misbehave. The uncertainty is the distance between unaltered runs. A run *misbehaved* if it
is farther from them than that in any quantity. All of this is ground truth, which no feature uses.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.behaviour import UNITS
from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.evaluation.judged_runs import JudgedRuns

LEVEL = 0.99  # share of unaltered runs within the uncertainty, for each quantity and for all
REPEATS = 20  # unaltered runs needed to estimate the uncertainty
# Smaller differences do not matter to a task, even if its runs hardly vary.
LEAST: Mapping[str, float] = {
    "driven_m": 0.1, "under_way_s": 1.0, "clearance_m": 0.02,
    "goals_reached": 0.5, "recoveries": 0.5, "commands_altered": 0.01,
}  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class TaskEffects:
    """The difference of each run from the unaltered runs of its block.

    Attributes
    ----------
    differences : DataFrame of n_runs rows
        A column for each quantity, in its unit; NaN where it was not measured.
    uncertainty : mapping of str to float
        Of each quantity, in its unit; NaN if there are too few unaltered runs.
    calm : ndarray of bool, shape (n_runs,)
        Whether no unaltered run of the block needed a recovery. Elsewhere, a run that is like them
        may be unusual.
    """

    differences: pd.DataFrame
    uncertainty: Mapping[str, float]
    calm: NDArray[np.bool_]

    @property
    def size(self) -> NDArray[np.float64]:
        """Largest difference of each run in units of its uncertainty; NaN if unknown, (n_runs,)."""
        scale = np.array([self.uncertainty[name] for name in UNITS])
        sizes = np.abs(self.differences.to_numpy(dtype=np.float64)) / scale
        known = np.isfinite(sizes).any(axis=1)
        return np.where(known, np.max(np.nan_to_num(sizes, nan=0.0), axis=1, initial=0.0), np.nan)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the runs that could be compared, shape (n_runs,)."""
        return np.isfinite(self.size)

    @property
    def misbehaved(self) -> NDArray[np.bool_]:
        """Mask of the runs that differ by more than the uncertainty, shape (n_runs,)."""
        return self.size > 1.0

    def table(self) -> pd.DataFrame:
        """Return a row for each quantity: its unit and its uncertainty."""
        rows = [
            {"quantity": name, "unit": UNITS[name], "uncertainty": uncertainty}
            for name, uncertainty in self.uncertainty.items()
        ]
        return pd.DataFrame(rows, columns=["quantity", "unit", "uncertainty"])


def task_effects(campaign: JudgedRuns) -> TaskEffects:
    """Return the effects of all runs of a campaign, and their uncertainty."""
    measured = pd.DataFrame(
        [json.loads(text) for text in campaign.truth["behaviour"]], columns=list(UNITS), dtype=float
    )
    unaltered = ~campaign.malicious & ~is_hard_negative(campaign.features)
    alike = [campaign.block, campaign.truth["conditions"].to_numpy()]
    differences = np.full(measured.shape, np.nan)
    for rows in measured.groupby(alike).indices.values():
        differences[rows] = _differences(measured.to_numpy()[rows], unaltered[rows])
    uncertainty = _uncertainty(np.abs(differences[unaltered]))
    recovered = campaign.block[unaltered & (measured["recoveries"] > 0.0)]
    return TaskEffects(
        pd.DataFrame(differences, columns=list(UNITS)),
        dict(zip(UNITS, uncertainty.tolist(), strict=True)),
        ~np.isin(campaign.block, recovered),
    )


def _uncertainty(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance between unaltered runs by chance, shape (n_quantities,).

    Any single quantity can make a run count as misbehaved. So the uncertainties are widened until
    `LEVEL` of the unaltered runs are within all of them.

    Parameters
    ----------
    distance : ndarray of shape (n_unaltered, n_quantities)
    """
    least = np.array([LEAST[name] for name in UNITS])
    alone = np.array([_within(column[np.isfinite(column)]) for column in distance.T])
    sizes = np.nan_to_num(distance / np.maximum(alone, least), nan=0.0)
    known = np.isfinite(distance[:, np.isfinite(alone)]).any(axis=1)
    wider = max(1.0, _within(sizes[known].max(axis=1))) if known.any() else 1.0
    return np.asarray(np.maximum(wider * alone, least), dtype=np.float64)


def _within(distance: NDArray[np.float64]) -> float:
    """Return the distance within which `LEVEL` of the runs are; NaN if there are too few."""
    if len(distance) < REPEATS:
        return np.nan
    return float(np.quantile(distance, LEVEL, method="higher"))


def _differences(values: NDArray[np.float64], unaltered: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance of each run of a block from the unaltered ones, (n_runs, n_quantities).

    Exact repetitions carry no information on chance, so they count once, and never for themselves.
    """
    repeats = np.unique(values[unaltered], axis=0)
    differences = np.full(values.shape, np.nan)
    for run, own in enumerate(values):
        others = repeats
        if unaltered[run]:
            others = repeats[~np.isclose(repeats, own, equal_nan=True).all(axis=1)]
        if len(others):
            differences[run] = own - _median(others)
    return differences


def _median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of each column, NaN without a value."""
    medians = np.full(values.shape[1], np.nan)
    given = np.isfinite(values).any(axis=0)
    medians[given] = np.nanmedian(values[:, given], axis=0)
    return medians
