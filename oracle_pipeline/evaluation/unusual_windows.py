"""Measures when a run is unusual, by family of features, for every window of every run.

A window's distance in one family is the largest robust z of the family's features, relative to
normal windows of other blocks. A distance is usual if it is at most that of 95 % of normal windows,
which are held out by block too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import CLIP, FlooredRobustScaler
from oracle_pipeline.datasets import feature_columns, feature_floors
from oracle_pipeline.scoring.cross_conformal import FOLDS, MIN_BLOCKS, assign_folds
from oracle_pipeline.scoring.feature_sets import feature_sets
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

USUAL = 95.0  # percentile of normal windows up to which a distance is usual
SEED = 0  # of the folds


@dataclass(frozen=True, eq=False, slots=True)
class UnusualWindows:
    """Distances of windows, family by family.

    Attributes
    ----------
    families : sequence of str, length n_families
    usual : ndarray of shape (n_families,)
        Upper limit of the usual distance.
    distance : ndarray of shape (n_windows, n_families)
        NaN where the window has no value in the family.
    farthest : ndarray of str, shape (n_windows, n_families)
        The feature with that distance.
    start_s : ndarray of shape (n_windows,)
        Start of each window [s of the recording].
    """

    families: Sequence[str]
    usual: NDArray[np.float64]
    distance: NDArray[np.float64]
    farthest: NDArray[np.object_]
    start_s: NDArray[np.float64]

    def where(self, chosen: NDArray[np.intp]) -> "UnusualWindows":
        """Return some of the windows, by number."""
        return UnusualWindows(
            self.families,
            self.usual,
            self.distance[chosen],
            self.farthest[chosen],
            self.start_s[chosen],
        )


def unusual_windows(runs: MeasuredRuns) -> UnusualWindows | None:
    """Measure every window of some runs; None with fewer than three blocks of normal runs."""
    if len(np.unique(runs.block[~runs.malicious])) < MIN_BLOCKS:
        return None
    columns = _windowed(runs)
    z = np.abs(_held_out_z(runs, columns))
    family = np.array([column.split(".", 1)[0] for column in columns])
    families = list(dict.fromkeys(family.tolist()))
    distance = np.full((len(z), len(families)), np.nan)
    farthest = np.full(distance.shape, "", dtype=object)
    known = np.where(np.isfinite(z), z, -1.0)
    for number, name in enumerate(families):
        of_family = np.flatnonzero(family == name)
        at = known[:, of_family].argmax(axis=1)
        largest = np.minimum(np.take_along_axis(known[:, of_family], at[:, None], 1)[:, 0], CLIP)
        distance[:, number] = np.where(largest >= 0.0, largest, np.nan)
        farthest[:, number] = np.array(columns, dtype=object)[of_family[at]]
    normal = distance[~runs.malicious[runs.run]]
    usual = np.array([_percentile(normal[:, number]) for number in range(len(families))])
    return UnusualWindows(families, usual, distance, farthest, runs.start_s)


def _windowed(runs: MeasuredRuns) -> list[str]:
    """Return the features of the oracle that windows have."""
    of_windows = set(feature_columns(runs.windows))
    return [name for name in feature_sets(runs.features).get("all", []) if name in of_windows]


def _held_out_z(runs: MeasuredRuns, columns: Sequence[str]) -> NDArray[np.float64]:
    """Return robust z relative to other blocks, shape (n_windows, n_columns)."""
    normal = ~runs.malicious
    names = np.unique(runs.block[normal])
    folds = assign_folds(names, FOLDS, np.random.default_rng(SEED))
    fold_of = dict(zip(names.tolist(), folds.tolist(), strict=True))
    fold = np.array([fold_of.get(block, 0) for block in runs.block.tolist()])[runs.run]
    table = runs.windows[list(columns)].astype(np.float64)
    z = np.full(table.shape, np.nan)
    for number in range(len(set(fold_of.values()))):
        fitted, scored = normal[runs.run] & (fold != number), fold == number
        scaler = FlooredRobustScaler(feature_floors(runs.windows)).fit(table[fitted])
        kept = np.isin(columns, scaler.kept_)
        distance = (table.loc[scored, scaler.kept_].to_numpy() - scaler.center_) / scaler.scale_
        z[np.ix_(scored, kept)] = distance
    return z


def _percentile(distances: NDArray[np.float64]) -> float:
    known = distances[np.isfinite(distances)]
    return float(np.percentile(known, USUAL)) if len(known) else np.nan
