"""Ranges of the planar laser scanners, one scanner at a time.

The thesis uses the variance of all ranges; one ray without a return is ``inf`` (REP 117), which
makes the variance NaN and then 0. Here rays without a valid range are counted, and the variance is
over the others. Robots differ in their scanners, so tables have the mean and the largest over the
scan topics: every run has the same columns.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.statistics.reduction import quantile_of
from oracle_pipeline.robots.roles import SCAN

_NEAR = 5.0  # percentile over the scans of the nearest return
_VARIANCE = "variance of the valid ranges in a scan, median over the scans, "
_NON_FINITE = "share of the ranges in a scan that are inf or NaN, median over the scans, "

FEATURES = (
    fp.Feature("range_variance_mean", "m^2", 1e-3, f"{_VARIANCE}mean over scanners", "domain"),
    fp.Feature("range_variance_max", "m^2", 1e-3, f"{_VARIANCE}maximum over scanners", "domain"),
    fp.Feature("non_finite_mean", "1", 1e-3, f"{_NON_FINITE}mean over scanners", "domain"),
    fp.Feature("non_finite_max", "1", 1e-3, f"{_NON_FINITE}maximum over scanners", "domain"),
    fp.Feature("clearance", "m", 0.02,
        "range of the nearest return in a scan, 5th percentile over the scans, maximum over the "
        "scanners", "domain", behaviour=True),
)  # fmt: skip


def keep(messages: Any) -> NDArray[np.float64]:
    """Return variance [m^2], non-finite share and least [m] of the ranges of ``LaserScan``s.

    Variance and least are over finite ranges in [range_min, range_max], NaN if there is none.
    """
    limits = np.column_stack([messages.range_min, messages.range_max])
    kept = np.full((len(limits), 3), np.nan)
    lengths = np.array([ranges.size for ranges in messages.ranges])
    for length in np.unique(lengths[lengths > 0]):
        scans = np.flatnonzero(lengths == length)
        ranges = np.stack(messages.ranges[scans].tolist()).astype(np.float64)
        low, high = limits[scans].T[..., np.newaxis]
        valid = (ranges >= low) & (ranges <= high)
        kept[scans, 1] = 1.0 - np.isfinite(ranges).mean(axis=1)
        counts = valid.sum(axis=1)
        for count in np.unique(counts[counts > 0]):
            rows = np.flatnonzero(counts == count)
            some = ranges[rows][valid[rows]].reshape(-1, count)
            kept[scans[rows], 0], kept[scans[rows], 2] = some.var(axis=1), some.min(axis=1)
    return kept


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute over all scan topics."""
    values: dict[str, float | fp.Missing] = {}
    empty = fp.Missing("no scan has a valid range")
    for column, name in enumerate(("range_variance", "non_finite")):
        scanners = _of_scanners(window, column, 50.0)
        values[f"{name}_mean"] = float(np.mean(scanners)) if scanners else empty
        values[f"{name}_max"] = max(scanners, default=empty)
    # The largest of the scanners: others may detect a part of the robot.
    values["clearance"] = max(_of_scanners(window, 2, _NEAR), default=empty)
    return values


def _of_scanners(window: fp.Window, column: int, percentile: float) -> list[float]:
    """Return a percentile over the scans of each scanner that has a value."""
    return [
        quantile_of(kept, percentile / 100.0)
        for series in window.topics["scans"].values()
        if (kept := series.values[~np.isnan(series.values[:, column]), column]).size
    ]


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of laser scans."""
    topics = {"scans": fp.Request(keep, role=SCAN, many=True)}
    return [fp.FeaturePlugin("laser", "contextual", FEATURES, compute, topics)]
