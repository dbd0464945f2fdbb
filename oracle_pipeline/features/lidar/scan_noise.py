"""Whether a laser scanner's noise is uniform over rays and time, as for a real sensor.

Ranges that were inserted or processed rarely have the noise of the sensor: they are too smooth, too
rough, or equal to an earlier scan. One scanner is enough to see this.
"""

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scan_agreement import CLOSER_M
from oracle_pipeline.features.geometry.scanner_setup import (
    SETUP_TOPICS,
    ScannerSetup,
    scanner_setup,
)
from oracle_pipeline.features.geometry.scans import Floats, RecordedScans, in_blocks
from oracle_pipeline.features.statistics.reduction import (
    MAD_TO_DEVIATION,
    largest,
    mean,
    quantile,
    smallest,
)

_OF = "over the scanners"
FEATURES = (
    fp.Feature("smooth", "1", 5e-3,
        "share of a scan's returns in long runs of rays that are much smoother (third difference) "
        f"than the scan, 95th percentile, maximum {_OF}", "domain"),
    fp.Feature("smooth_mean", "1", 3e-3,
        "share of a scan's returns in shorter runs of rays that are much smoother (third "
        f"difference) than the scan, mean over the scans, maximum {_OF}", "domain"),
    fp.Feature("rough", "1", 5e-3,
        "share of a scan's returns in runs of rays that are much rougher (third difference) than "
        f"the scan, 95th percentile, maximum {_OF}", "domain"),
    fp.Feature("repeated", "1", 5e-3,
        f"share of the scans with exactly the ranges of an earlier scan, maximum {_OF}", "domain"),
    fp.Feature("still_noise_max", "m", 1e-3,
        f"standard deviation of ranges while the robot stands still, median, maximum {_OF}",
        "domain"),
    fp.Feature("still_noise_min", "m", 1e-3,
        f"standard deviation of ranges while the robot stands still, median, minimum {_OF}",
        "domain"),
    fp.Feature("still_flicker", "1", 2e-3,
        f"share of the ranges that change by more than {CLOSER_M} m while the robot stands still, "
        f"mean, maximum {_OF}", "domain"),
)  # fmt: skip

_STRETCH = 4  # consecutive bends of a stretch
_LONG = 8  # of a long one; uniform noise has none in a thousand scans
_SMOOTH, _ROUGH = 0.25, 4.0  # of the scan's median bend
_FINEST_M = 1e-4  # smaller bends count as zero
_STILL_M, _STILL_RAD = 2e-3, 2e-3  # most motion between two scans of a standing robot
_NEXT_S = 0.5  # most time between scans of a standing robot


@dataclass(frozen=True, slots=True)
class _Noise:
    """Noise of each scan of a topic."""

    smooth: fp.Series
    smooth_short: fp.Series
    rough: fp.Series
    repeated: fp.Series  # 1 or 0
    still: fp.Series  # [m], of scans in which the robot stands
    flicker: fp.Series


def prepare(window: fp.Window) -> dict[str, _Noise]:
    """Measure each scan of the recording."""
    setup = scanner_setup(window)
    return {topic: _noise(setup, topic, scans) for topic, scans in setup.scanners.items()}


def compute(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    scanners: dict[str, _Noise] = window.prepared
    empty = "no scan has enough neighbouring valid ranges"
    moving = "the robot did not stand still between two scans"
    still = {topic: quantile(noise.still, window, 0.5) for topic, noise in scanners.items()}
    return {
        "smooth": largest(
            {t: quantile(n.smooth, window, 0.95) for t, n in scanners.items()}, empty
        ),
        "smooth_mean": largest(
            {t: mean(n.smooth_short, window) for t, n in scanners.items()}, empty
        ),
        "rough": largest({t: quantile(n.rough, window, 0.95) for t, n in scanners.items()}, empty),
        "repeated": largest({t: mean(n.repeated, window) for t, n in scanners.items()}, empty),
        "still_noise_max": largest(still, moving),
        "still_noise_min": smallest(still, moving),
        "still_flicker": largest({t: mean(n.flicker, window) for t, n in scanners.items()}, moving),
    }


@jit
def uneven(ranges: Floats) -> tuple[float, float, float]:
    """Return the shares of bends in long smooth, smooth and rough stretches; NaN without a bend.

    A bend is the third difference of neighbouring ranges, in which walls and pillars hardly show.
    """
    bends = np.abs(ranges[3:] - 3.0 * ranges[2:-1] + 3.0 * ranges[1:-2] - ranges[:-3])
    known = bends[np.isfinite(bends)]
    if len(known) < _STRETCH:
        return math.nan, math.nan, math.nan
    usual = max(np.median(known), _FINEST_M)
    smooth = bends <= _SMOOTH * usual
    rough = (bends >= _ROUGH * usual) & (bends < CLOSER_M)
    return (
        _in_stretches(smooth, _LONG) / len(known),
        _in_stretches(smooth, _STRETCH) / len(known),
        _in_stretches(rough, _STRETCH) / len(known),
    )


@jit
def _in_stretches(flags: NDArray[np.bool_], shortest: int) -> int:
    """Count the true flags in runs of at least some length."""
    total = run = 0
    for flag in flags:
        run = run + 1 if flag else 0
        if run == shortest:
            total += shortest
        elif run > shortest:
            total += 1
    return total


@jit
def _uneven(ranges: Floats) -> Floats:
    shares = np.empty((len(ranges), 3))
    for i in range(len(ranges)):
        shares[i, 0], shares[i, 1], shares[i, 2] = uneven(ranges[i])
    return shares


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of a scanner's noise."""
    return [
        fp.FeaturePlugin("scan_noise", "noise", FEATURES, compute, SETUP_TOPICS, prepare=prepare)
    ]


def _noise(setup: ScannerSetup, topic: str, scans: RecordedScans) -> _Noise:
    seen: set[bytes] = set()

    def measured(part: slice) -> tuple[Floats, Floats]:
        ranges = scans.rows(part).ranges
        return _uneven(ranges), _repeated(ranges, seen)

    shares, repeated = in_blocks(len(scans.times_s), scans.rays, measured)
    smooth, smooth_short, rough = shares.T
    still, flicker = _standing(setup, topic, scans)
    return _Noise(
        fp.Series(scans.times_s, smooth), fp.Series(scans.times_s, smooth_short),
        fp.Series(scans.times_s, rough), fp.Series(scans.times_s, repeated), still, flicker,
    )  # fmt: skip


def _repeated(ranges: Floats, seen: set[bytes]) -> Floats:
    """Return 1 for scans whose ranges repeat earlier ones, 0 for others; NaN without returns.

    Digests of all of them are added to what was seen.
    """
    again = np.full(len(ranges), np.nan)
    for i in np.flatnonzero(np.isfinite(ranges).any(axis=1)):
        content = hashlib.sha256(ranges[i]).digest()  # for which processors have instructions
        again[i] = content in seen
        seen.add(content)
    return again


def _standing(setup: ScannerSetup, topic: str, scans: RecordedScans) -> tuple[fp.Series, fp.Series]:
    """Return noise [m] and flicker of the scans between which the robot stood."""
    nothing = fp.Series(np.empty(0), np.empty(0))
    mount = setup.mounts.get(topic)
    if setup.motion is None or mount is None or len(scans.stamps_s) < 2:
        return nothing, nothing
    placed = setup.poses(mount, scans.stamps_s)
    moved_m = np.abs(np.diff(placed.translation))
    turned = np.abs(np.angle(placed.rotation[1:] / placed.rotation[:-1]))
    near = np.abs(np.diff(scans.stamps_s)) <= _NEXT_S
    after = np.flatnonzero((moved_m < _STILL_M) & (turned < _STILL_RAD) & near) + 1
    deviation, share = in_blocks(
        len(after),
        scans.rays,
        lambda part: _changes(scans.rows(after[part] - 1).ranges, scans.rows(after[part]).ranges),
    )
    times_s = scans.times_s[after]
    return fp.Series(times_s, deviation), fp.Series(times_s, share)


def _changes(before: Floats, now: Floats) -> tuple[Floats, Floats]:
    """Return the difference of ranges [m] and the share of large differences, for each scan."""
    change = np.abs(now - before)
    deviation, share = np.full(len(change), np.nan), np.full(len(change), np.nan)
    for k, (row, known) in enumerate(zip(change, np.isfinite(change), strict=True)):
        if known.any():
            deviation[k] = MAD_TO_DEVIATION * np.median(row[known]) / math.sqrt(2.0)
            share[k] = np.mean(row[known] > CLOSER_M)
    return deviation, share
