"""The effect of an attack on the robot's task, and whether it is more than chance.

The runs of a block have the same start and goals. Each is compared with the unaltered runs of its
block, the passthroughs and the shadow controls, if these were made under the same conditions: a
robot that has to drive slowly does not misbehave. How far unaltered runs are from each other is the
uncertainty. A run *misbehaved* if it is farther from them than that in any quantity. All of this is
ground truth, which no feature sees.
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

LEVEL = 0.99  # share of the unaltered runs that are called so by a quantity, and by all together
REPEATS = 20  # unaltered runs that are needed to say how far they are from each other
# Smaller differences do not matter to a task, however alike its runs are.
LEAST: Mapping[str, float] = {
    "driven_m": 0.1,
    "under_way_s": 1.0,
    "clearance_m": 0.02,
    "goals_reached": 0.5,
    "recoveries": 0.5,
    "commands_altered": 0.01,
}


@dataclass(frozen=True, eq=False, slots=True)
class TaskEffects:
    """How each run differs from the unaltered runs of its block.

    Attributes
    ----------
    differences : DataFrame of n_runs rows
        A column for each quantity, in its unit; NaN where it was not measured.
    uncertainty : mapping of str to float
        Of each quantity, in its unit; NaN if there are too few unaltered runs.
    """

    differences: pd.DataFrame
    uncertainty: Mapping[str, float]

    @property
    def size(self) -> NDArray[np.float64]:
        """Largest difference of each run over its uncertainty; NaN if unknown, shape (n_runs,)."""
        scale = np.array([self.uncertainty[name] for name in UNITS])
        sizes = np.abs(self.differences.to_numpy(dtype=np.float64)) / scale
        known = np.isfinite(sizes).any(axis=1)
        return np.where(known, np.max(np.nan_to_num(sizes, nan=0.0), axis=1, initial=0.0), np.nan)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which runs could be compared, shape (n_runs,)."""
        return np.isfinite(self.size)

    @property
    def misbehaved(self) -> NDArray[np.bool_]:
        """Which runs differ by more than their uncertainty, shape (n_runs,)."""
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
    return TaskEffects(
        pd.DataFrame(differences, columns=list(UNITS)),
        dict(zip(UNITS, uncertainty.tolist(), strict=True)),
    )


def _uncertainty(apart: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far unaltered runs are from each other by chance, shape (n_quantities,).

    Any single quantity can make a run count as misbehaved. So the uncertainties are widened until
    `LEVEL` of the unaltered runs are within all of them.

    Parameters
    ----------
    apart : ndarray of shape (n_unaltered, n_quantities)
    """
    least = np.array([LEAST[name] for name in UNITS])
    alone = np.array([_within(column[np.isfinite(column)]) for column in apart.T])
    sizes = np.nan_to_num(apart / np.maximum(alone, least), nan=0.0)
    known = np.isfinite(apart[:, np.isfinite(alone)]).any(axis=1)
    wider = max(1.0, _within(sizes[known].max(axis=1))) if known.any() else 1.0
    return np.asarray(np.maximum(wider * alone, least), dtype=np.float64)


def _within(apart: NDArray[np.float64]) -> float:
    """Return the distance within which `LEVEL` of some runs are; NaN if they are too few."""
    if len(apart) < REPEATS:
        return np.nan
    return float(np.quantile(apart, LEVEL, method="higher"))


def _differences(values: NDArray[np.float64], unaltered: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return how far each run of a block is from the unaltered ones, shape (n_runs, n_quantities).

    An exact repetition of a run says nothing about chance, so each is counted once and none stands
    for itself.
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
    """Return the median of each column, NaN where there is no value."""
    medians = np.full(values.shape[1], np.nan)
    given = np.isfinite(values).any(axis=0)
    medians[given] = np.nanmedian(values[:, given], axis=0)
    return medians
