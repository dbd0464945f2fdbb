"""Ranges of the planar laser scanners, one scanner at a time.

The thesis takes the variance of all ranges; one ray that hits nothing is ``inf`` (REP 117) and
makes that NaN, then 0. Here rays without a valid range are counted instead, and the variance is
that of the others. Robots differ in their scanners, so tables hold the mean and the largest over
the scan topics: every run has the same columns.
"""

from typing import Any

import numpy as np

from oracle_pipeline.features.plugin import (
    Feature,
    FeaturePlugin,
    Missing,
    Request,
    Values,
    Window,
    hookimpl,
)
from oracle_pipeline.robots.roles import SCAN

_VARIANCE = "variance of a scan's valid ranges, median over its scans, "
_NON_FINITE = "share of a scan's rays that are inf or NaN, median over its scans, "

FEATURES = (
    Feature("range_variance_mean", "m^2", 1e-3, f"{_VARIANCE}mean over the scanners", "domain"),
    Feature("range_variance_max", "m^2", 1e-3, f"{_VARIANCE}largest of the scanners", "domain"),
    Feature("non_finite_mean", "1", 1e-3, f"{_NON_FINITE}mean over the scanners", "domain"),
    Feature("non_finite_max", "1", 1e-3, f"{_NON_FINITE}largest of the scanners", "domain"),
)


def keep(message: Any) -> tuple[float, float]:
    """Return variance [m^2] and non-finite share of the ranges of a ``sensor_msgs/msg/LaserScan``.

    The variance is over finite ranges in [range_min, range_max], NaN if there is none.
    """
    ranges = np.asarray(message.ranges, dtype=np.float64)
    if ranges.size == 0:
        return np.nan, np.nan
    valid = ranges[(ranges >= message.range_min) & (ranges <= message.range_max)]
    variance = float(valid.var()) if valid.size else np.nan
    return variance, 1.0 - float(np.isfinite(ranges).mean())


def compute(window: Window) -> Values | Missing:
    """Compute over all scan topics."""
    values: dict[str, float | Missing] = {}
    for column, name in enumerate(("range_variance", "non_finite")):
        scanners = [
            float(np.median(kept))
            for series in window.topics["scans"].values()
            if (kept := series.values[~np.isnan(series.values[:, column]), column]).size
        ]
        empty = Missing("no scan has a valid range")
        values[f"{name}_mean"] = float(np.mean(scanners)) if scanners else empty
        values[f"{name}_max"] = max(scanners) if scanners else empty
    return values


@hookimpl
def register_features() -> list[FeaturePlugin]:
    """Offer the features of laser scans."""
    topics = {"scans": Request(keep, role=SCAN)}
    return [FeaturePlugin("laser", "contextual", FEATURES, compute, topics)]
