"""The noise of a laser scanner: along a scan, and from one scan to the next.

These need no second sensor. Surfaces are smooth and stand still; noise that an attack adds to
each ray is neither. An object that is put into the scans is both, so it is not seen here.
"""

from dataclasses import dataclass

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scan_agreement import CLOSER_M, agreement
from oracle_pipeline.features.geometry.scan_projection import project
from oracle_pipeline.features.geometry.scanner_setup import (
    SETUP_TOPICS,
    ScannerSetup,
    scanner_setup,
)
from oracle_pipeline.features.geometry.scans import Floats, RecordedScans, in_blocks
from oracle_pipeline.features.statistics.arrays import autocorrelation, roughness
from oracle_pipeline.features.statistics.reduction import largest, quantile, row_medians

FEATURES = (
    fp.Feature("roughness", "1", 1e-3,
        "absolute second difference of neighbouring ranges over the range, median, maximum over "
        "the scanners", "domain"),
    fp.Feature("innovation", "m", 1e-3,
        "distance from a return to the nearest return of the previous scan after motion "
        "compensation, median, maximum over the scanners", "domain"),
    fp.Feature("innovation_whiteness", "1", 0.02,
        "1 - lag-1 autocorrelation along the rays of the range change since the previous scan, "
        "after motion compensation, median, maximum over the scanners", "domain"),
)  # fmt: skip

_LONGEST_GAP_S = 1.0  # between compared scans


@dataclass(frozen=True, slots=True)
class _Scanner:
    """Noise of each scan of a topic."""

    roughness: fp.Series
    innovation: fp.Series | None  # [m]
    whiteness: fp.Series | None


def prepare(window: fp.Window) -> dict[str, _Scanner]:
    """Compute the figures of each scan of the recording."""
    setup = scanner_setup(window)
    return {topic: _scanner(setup, topic, scans) for topic, scans in setup.scanners.items()}


def compute(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    scanners: dict[str, _Scanner] = window.prepared
    roughness = {t: quantile(s.roughness, window, 0.5) for t, s in scanners.items()}
    innovation = {
        t: quantile(s.innovation, window, 0.5) for t, s in scanners.items() if s.innovation
    }
    whiteness = {t: quantile(s.whiteness, window, 0.5) for t, s in scanners.items() if s.whiteness}
    alone = "no two consecutive scans with odometry"
    return {
        "roughness": largest(roughness, "no scan has three neighbouring valid ranges"),
        "innovation": largest(innovation, alone),
        "innovation_whiteness": largest(whiteness, alone),
    }


def whiteness(signed: Floats) -> Floats:
    """Return one less the lag-one autocorrelation along each row, shape (n,); NaN is left out.

    White noise has 1. Differences of an edge that moved, `CLOSER_M` or more, do not count.
    """
    kept = np.where(np.abs(signed) < CLOSER_M, signed, np.nan)
    kept = kept - row_medians(kept)[:, np.newaxis]
    return 1.0 - _autocorrelations(kept)


@jit
def _autocorrelations(rows: Floats) -> Floats:
    """Return the lag-one autocorrelation of each row, whose mean counts as 0; NaN if unknown."""
    found = np.full(len(rows), np.nan)
    for i in range(len(rows)):
        found[i] = autocorrelation(rows[i], 0.0)
    return found


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of single laser scanners."""
    return [fp.FeaturePlugin("scan", "scan", FEATURES, compute, SETUP_TOPICS, prepare=prepare)]


def _scanner(setup: ScannerSetup, topic: str, scans: RecordedScans) -> _Scanner:
    (along,) = in_blocks(
        len(scans.times_s), scans.rays, lambda part: (roughness(scans.rows(part).ranges),)
    )
    rough = fp.Series(scans.times_s, along)
    mount = setup.mounts.get(topic)
    if setup.motion is None or mount is None:
        return _Scanner(rough, None, None)
    after = np.flatnonzero(np.abs(np.diff(scans.stamps_s)) <= _LONGEST_GAP_S) + 1
    placed = setup.poses(mount, scans.stamps_s)
    moved = placed.at(after - 1).inverse().compose(placed.at(after))

    def compared(part: slice) -> tuple[Floats, Floats]:
        in_scan_before = project(scans.rows(after[part]), moved.at(part))
        agreed = agreement(in_scan_before, scans.rows(after[part] - 1))
        return row_medians(agreed.residual), whiteness(agreed.signed)

    innovation, white = in_blocks(len(after), scans.rays, compared)
    times_s = scans.times_s[after]
    return _Scanner(rough, fp.Series(times_s, innovation), fp.Series(times_s, white))
