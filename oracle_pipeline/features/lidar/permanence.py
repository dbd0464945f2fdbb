"""Whether objects that one laser scanner detects stay in place while the robot drives past.

No second sensor and no map is needed: the scanner's own earlier scans have the objects and the free
space, and odometry the motion since. An object has appeared if it is in space that was free before,
and has vanished if the scanner now measures through it. An object that moves with the robot is
loose. A place that the robot drives across later cannot contain an object.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scan_agreement import CLOSER_M, contradicted_shares
from oracle_pipeline.features.geometry.scan_projection import project
from oracle_pipeline.features.geometry.scanner_setup import (
    SETUP_TOPICS,
    ScannerSetup,
    scanner_setup,
)
from oracle_pipeline.features.geometry.scans import (
    Bools,
    Floats,
    Ints,
    Points,
    RecordedScans,
    in_blocks,
)
from oracle_pipeline.features.statistics.reduction import largest, mean, quantile
from oracle_pipeline.features.statistics.times import even_times, nearest

_EARLIER_S = 1.0  # between two compared scans
_LATER_S = 1.0  # least time until the robot drives across a return
_PATH_STEP_S = 0.05
_FARTHEST = 2**26  # m from the origin; beyond it, a pose is no pose
_WIDEST = 2**31  # cells from the corner of the path
_CELL_M = 0.1  # of the robot's path; a robot is wider than that
_FEWEST = 2  # returns on the path of a scan that counts
_SMALL_RAYS = (4, 80)  # least and most rays on a compact object
_STEP_M = 0.15  # largest step from ray to ray on one object
_GAP_RAYS = 2.5  # most rays missing from a scan of 360 degrees
_NEXT_S = 0.4  # between two scans in which an object is compared
_STILL_M = 1e-6  # below the resolution of a range (float32): rounding of poses, not motion
_FAR_M = 0.6  # largest motion of the same object between two scans

_SCANS = "maximum over the scanners"
FEATURES = (
    fp.Feature("appeared", "1", 2e-3,
        f"share of a scan's returns for which the scan {_EARLIER_S:g} s earlier measures "
        f"{CLOSER_M} m or more behind them, 95th percentile, {_SCANS}", "domain"),
    fp.Feature("vanished", "1", 2e-3,
        f"share of the returns {_EARLIER_S:g} s earlier for which a scan measures {CLOSER_M} m or "
        f"more behind them, 95th percentile, {_SCANS}", "domain"),
    fp.Feature("changed_peak", "1", 5e-3,
        f"share that appeared or vanished, largest held over three consecutive scans, {_SCANS}",
        "domain"),
    fp.Feature("loose", "m", 0.01,
        "apparent displacement of the fastest compact object between two scans after motion "
        f"compensation, 90th percentile, {_SCANS}", "domain"),
    fp.Feature("driven_across", "1", 0.01,
        f"share of the scans with returns where the robot drives later, {_SCANS}", "domain",
        per_window=False),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Seen:
    """Changes in each scan of a scanner since an earlier one."""

    appeared: fp.Series
    vanished: fp.Series
    loose: fp.Series  # [m]
    across: fp.Series  # 1 or 0, of every scan


def prepare(window: fp.Window) -> dict[str, Seen] | fp.Missing:
    """Compare each scan with an earlier one of the same scanner, over the whole recording."""
    setup = scanner_setup(window)
    if setup.motion is None:
        return fp.Missing("no odometry")
    path = _Path.of(setup)
    return {topic: _seen(setup, topic, path) for topic in setup.mounts} or fp.Missing(
        "no horizontal laser scanner"
    )


def compute(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    seen: dict[str, Seen] = window.prepared
    alone = f"no two scans {_EARLIER_S:g} s apart"
    return {
        "appeared": largest(
            {t: quantile(s.appeared, window, 0.95) for t, s in seen.items()}, alone
        ),
        "vanished": largest(
            {t: quantile(s.vanished, window, 0.95) for t, s in seen.items()}, alone
        ),
        "changed_peak": largest({t: _peak(s, window) for t, s in seen.items()}, alone),
        "loose": largest(
            {t: quantile(s.loose, window, 0.9) for t, s in seen.items()},
            "no compact object in two consecutive scans",
        ),
        "driven_across": largest(
            {t: mean(s.across, window) for t, s in seen.items()}, "no scan in this window"
        ),
    }


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of the permanence of objects."""
    return [
        fp.FeaturePlugin(
            "permanence", "permanence", FEATURES, compute, SETUP_TOPICS, prepare=prepare
        )
    ]


def _seen(setup: ScannerSetup, topic: str, path: "_Path") -> Seen:
    scans, mount = setup.scanners[topic], setup.mounts[topic]
    placed = setup.poses(mount, scans.stamps_s)
    now, before = _apart(scans.stamps_s, _EARLIER_S)
    moved = placed.at(before).inverse().compose(placed.at(now))
    back = moved.inverse()

    def compared(part: slice) -> tuple[Floats, Floats]:
        later, earlier = scans.rows(now[part]), scans.rows(before[part])
        return (
            contradicted_shares(project(later, moved.at(part)), earlier),
            contradicted_shares(project(earlier, back.at(part)), later),
        )

    appeared, vanished = in_blocks(len(now), scans.rays, compared)
    loose, across = _in_world(scans, placed, path)
    return Seen(
        fp.Series(scans.times_s[now], appeared),
        fp.Series(scans.times_s[now], vanished),
        loose,
        fp.Series(scans.times_s, across),
    )


def _peak(seen: Seen, window: fp.Window) -> float:
    changed = np.fmax(seen.appeared.values, seen.vanished.values)
    if len(changed) < 3:
        return math.nan
    kept_up = np.min([changed[:-2], changed[1:-1], changed[2:]], axis=0)
    return quantile(fp.Series(seen.appeared.times_s[1:-1], kept_up), window, 1.0)


def _apart(stamps_s: Floats, earlier_s: float) -> tuple[Ints, Ints]:
    """Return the indices of scans, and of scans that are older by about ``earlier_s``."""
    if len(stamps_s) < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    order = np.argsort(stamps_s, kind="stable")
    before = order[nearest(stamps_s[order], stamps_s - earlier_s)]
    passed_s = stamps_s - stamps_s[before]
    now = np.flatnonzero(np.abs(passed_s - earlier_s) <= 0.5 * earlier_s)
    return now, before[now]


@dataclass(frozen=True, slots=True)
class _Path:
    """When the robot was last in each cell that it drove through; the first entry is no cell."""

    corner: complex  # of cell (0, 0), in the odometry frame
    cells: Ints  # both numbers of a cell as one, ascending
    last_s: Floats  # stamp

    @classmethod
    def of(cls, setup: ScannerSetup) -> "_Path":
        """Return the path of the robot during its scans."""
        assert setup.motion is not None  # noqa: S101 -- checked before
        stamps_s = np.concatenate([scans.stamps_s for scans in setup.scanners.values()])
        end_s = stamps_s.max() + _PATH_STEP_S
        steps_s = even_times(stamps_s.min(), end_s, _PATH_STEP_S, stamps_s)
        places = setup.motion.base(steps_s).translation
        near = (np.abs(places.real) < _FARTHEST) & (np.abs(places.imag) < _FARTHEST)  # no NaN
        places, steps_s = places[near], steps_s[near]
        corner = complex(places.real.min(initial=np.inf), places.imag.min(initial=np.inf))
        cells = np.append(_cells(places - corner), -1)[::-1]  # the last stay in a cell first
        cells, last = np.unique(cells, return_index=True)
        return cls(corner, cells, np.append(steps_s, -np.inf)[::-1][last])

    def crossed(self, world: Points, stamps_s: Floats) -> Bools:
        """Return which scans have returns where the robot drove across later, shape (n,)."""
        cells = _cells(world - self.corner)
        found = np.minimum(np.searchsorted(self.cells, cells), len(self.cells) - 1)
        later = self.last_s[found] > stamps_s[:, np.newaxis] + _LATER_S
        across = later & (self.cells[found] == cells)
        return np.asarray(across.sum(axis=1) >= _FEWEST, dtype=np.bool_)


def _cells(from_corner: Points) -> Ints:
    """Return the cells of points as one number each; -1 outside the path's quadrant."""
    x, y = from_corner.real / _CELL_M, from_corner.imag / _CELL_M
    inside = (x >= 0.0) & (x < _WIDEST) & (y >= 0.0) & (y < _WIDEST)  # false for NaN
    columns, rows = (np.where(inside, each, 0.0).astype(np.int64) for each in (x, y))
    return np.where(inside, columns << 31 | rows, -1)


def _in_world(scans: RecordedScans, placed: PlanarPose, path: _Path) -> tuple[fp.Series, Floats]:
    """Return the distance that the fastest compact object moved between scans [m].

    Also return, for all scans, whether the robot drives across a return later, 1 or 0.
    """
    around = 2.0 * np.pi / np.abs(scans.angle_increment.ravel())
    closed = np.abs(around - scans.rays) < _GAP_RAYS

    def seen(part: slice) -> tuple[NDArray[Any], ...]:
        some = scans.rows(part)
        world = project(some, placed.at(part))
        return *_centres(some.ranges, world, closed[part]), path.crossed(world, some.stamps_s)

    counts, centres, across = in_blocks(len(scans.times_s), scans.rays, seen)
    now, before = _apart(scans.stamps_s, _NEXT_S)
    ends = np.cumsum(counts)
    gone = _fastest(centres, ends - counts, ends, now, before)
    return fp.Series(scans.times_s[now], gone), across.astype(np.float64)


@jit
def _centres(ranges: Floats, world: Points, closed: Bools) -> tuple[Ints, Points]:
    """Return the number of compact objects in each scan, and the centres of all."""
    size = ranges.shape[1]
    counts = np.zeros(len(ranges), np.int64)
    centres = np.empty(ranges.size, np.complex128)
    number = 0
    for n in range(len(ranges)):
        for first, after in _compact(ranges[n], closed[n]):
            total = 0j
            for i in range(first, after):
                total += world[n, i % size]
            centres[number] = total / (after - first)
            counts[n] += 1
            number += 1
    return counts, centres[:number].copy()


@jit
def _fastest(centres: Points, begins: Ints, ends: Ints, now: Ints, before: Ints) -> Floats:
    fastest = np.full(len(now), np.nan)
    for k in range(len(now)):
        for i in range(begins[now[k]], ends[now[k]]):
            here = centres[i]
            if np.isnan(here.real):
                break
            gone = math.inf
            for j in range(begins[before[k]], ends[before[k]]):
                there = centres[j]
                if np.isnan(there.real):
                    break
                gone = min(gone, abs(here - there))
            if gone < _STILL_M:
                gone = 0.0
            if gone <= _FAR_M and not gone < fastest[k]:
                fastest[k] = gone
    return fastest


@jit
def _compact(ranges: Floats, closed: bool) -> Ints:
    """Return first and one past last ray of the compact objects in a scan, shape (n, 2).

    In a scan of 360 degrees, ray numbers continue past its end.
    """
    fewest, most = _SMALL_RAYS
    size = len(ranges)
    found = np.empty((size, 2), np.int64)
    count, start = 0, -1
    for i in range(1, 2 * size if closed else size):
        before, now = ranges[(i - 1) % size], ranges[i % size]
        if abs(now - before) < _STEP_M:
            continue
        in_front = ranges[(start - 1) % size] > ranges[start % size] + CLOSER_M
        in_front = in_front and now > before + CLOSER_M
        if start >= 0 and in_front and fewest <= i - start <= most:
            found[count, 0], found[count, 1] = start, i
            count += 1
        if i >= size:
            break
        start = i
    return found[:count]
