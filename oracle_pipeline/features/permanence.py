"""Whether objects that one laser scanner sees stay in place while the robot drives past.

No second sensor and no map is needed: the scanner's own earlier scans say what stood there and
where there was free space, odometry says how it moved since. An object has appeared if it is where
the scanner saw free space before, and it has vanished if the scanner now sees through it. An object
that moves with the robot is loose. A place that the robot drives across cannot have contained an
object.
"""

import math
from dataclasses import dataclass

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.plugin import (
    Feature,
    FeaturePlugin,
    Missing,
    Series,
    Values,
    Window,
    hookimpl,
)
from oracle_pipeline.features.reduction import largest, mean, quantile
from oracle_pipeline.features.scan_geometry import (
    CLOSER_M,
    SETUP_TOPICS,
    Bools,
    Floats,
    Ints,
    Points,
    ScannerSetup,
    Scans,
    agreement,
    nearest,
    scanner_setup,
)

_EARLIER_S = 1.0  # between two scans that are compared
_LATER_S = 1.0  # at least until the robot drives across what it saw
_PATH_STEP_S = 0.05
_CELL_M = 0.1  # of the robot's path; a robot is wider than that
_FEWEST = 2  # returns on the path that count
_SMALL_RAYS = (4, 80)  # rays that a compact thing takes
_STEP_M = 0.15  # from ray to ray on one thing, at most
_GAP_RAYS = 2.5  # that are missing at most from a scan that closes around
_NEXT_S = 0.4  # between two scans in which it is looked for
_STILL_M = 1e-6  # below the resolution of a range (float32): rounding of poses, not motion
_FAR_M = 0.6  # that it may have moved between two scans to be the same

_SCANS = "largest of the scanners"
FEATURES = (
    Feature(
        "appeared", "1", 2e-3,
        f"share of a scan's returns that the scan {_EARLIER_S:g} s before looks through by "
        f"{CLOSER_M} m, 95th percentile, {_SCANS}", "domain",
    ),
    Feature(
        "vanished", "1", 2e-3,
        f"share of the returns of {_EARLIER_S:g} s before that a scan looks through by "
        f"{CLOSER_M} m, 95th percentile, {_SCANS}", "domain",
    ),
    Feature(
        "changed_peak", "1", 5e-3,
        f"share that appeared or vanished, largest that three scans in a row keep up, {_SCANS}",
        "domain",
    ),
    Feature(
        "loose", "m", 0.01,
        "way that the fastest compact thing seems to go between two scans, the robot's motion "
        f"taken out, 90th percentile, {_SCANS}", "domain",
    ),
    Feature(
        "driven_across", "1", 0.01,
        f"share of the scans with returns where the robot drives across later, {_SCANS}", "domain",
        per_window=False,
    ),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Seen:
    """Of each scan of a scanner that has an earlier one."""

    appeared: Series
    vanished: Series
    loose: Series  # [m]
    across: Series  # 1 or 0, of every scan


def prepare(window: Window) -> dict[str, Seen] | Missing:
    """Hold each scan against the same scanner's earlier one, over the whole recording."""
    setup = scanner_setup(window)
    if setup.motion is None:
        return Missing("no odometry")
    path = _Path.of(setup)
    return {topic: _seen(setup, topic, path) for topic in setup.mounts} or Missing(
        "no level laser scanner"
    )


def compute(window: Window) -> Values:
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
            "no compact thing was seen twice",
        ),
        "driven_across": largest(
            {t: mean(s.across, window) for t, s in seen.items()}, "no scan in this window"
        ),
    }


@hookimpl
def register_features() -> list[FeaturePlugin]:
    """Offer the features of things that stay where they are."""
    return [
        FeaturePlugin("permanence", "permanence", FEATURES, compute, SETUP_TOPICS, prepare=prepare)
    ]


def _seen(setup: ScannerSetup, topic: str, path: "_Path") -> Seen:
    scans, mount = setup.scanners[topic], setup.mounts[topic]
    placed = setup.placed(mount, scans.stamps_s)
    world = placed.columns().apply(scans.points())
    across = path.crossed(world, scans.stamps_s)
    now, before = _apart(scans.stamps_s, _EARLIER_S)
    later, earlier = scans.rows(now), scans.rows(before)
    moved = placed.at(before).inverse().compose(placed.at(now))
    appeared = agreement(moved.columns().apply(later.points()), earlier)
    vanished = agreement(moved.inverse().columns().apply(earlier.points()), later)
    return Seen(
        Series(later.times_s, appeared.contradicted_share()),
        Series(later.times_s, vanished.contradicted_share()),
        _loose(scans, world),
        Series(scans.times_s, across.astype(np.float64)),
    )


def _peak(seen: Seen, window: Window) -> float:
    changed = np.fmax(seen.appeared.values, seen.vanished.values)
    if len(changed) < 3:
        return math.nan
    kept_up = np.min([changed[:-2], changed[1:-1], changed[2:]], axis=0)
    return quantile(Series(seen.appeared.times_s[1:-1], kept_up), window, 1.0)


def _apart(stamps_s: Floats, earlier_s: float) -> tuple[Ints, Ints]:
    """Return the indices of scans, and of those that are about so much older."""
    if len(stamps_s) < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    order = np.argsort(stamps_s, kind="stable")
    before = order[nearest(stamps_s[order], stamps_s - earlier_s)]
    passed_s = stamps_s - stamps_s[before]
    now = np.flatnonzero(np.abs(passed_s - earlier_s) <= 0.5 * earlier_s)
    return now, before[now]


@dataclass(frozen=True, slots=True)
class _Path:
    """When the robot was last in each cell that it drove through."""

    corner: complex  # of cell (0, 0), in the odometry frame
    last_s: Floats  # stamp, shape (rows, columns); -inf where it never was

    @classmethod
    def of(cls, setup: ScannerSetup) -> "_Path":
        """Follow the robot while its scanners looked."""
        assert setup.motion is not None  # noqa: S101 -- checked before
        stamps_s = np.concatenate([scans.stamps_s for scans in setup.scanners.values()])
        steps_s = np.arange(stamps_s.min(), stamps_s.max() + _PATH_STEP_S, _PATH_STEP_S)
        places = setup.motion.base(steps_s).shift
        corner = complex(places.real.min(), places.imag.min())
        cells = np.floor((places - corner).view(np.float64).reshape(-1, 2) / _CELL_M)
        columns, rows = cells.astype(np.int64).T
        last_s = np.full((int(rows.max()) + 1, int(columns.max()) + 1), -np.inf)
        last_s[rows, columns] = steps_s  # of equal cells the last one stays
        return cls(corner, last_s)

    def crossed(self, world: Points, stamps_s: Floats) -> Bools:
        """Tell which scans saw something where the robot drove across later, shape (n,)."""
        return _crossed((world - self.corner) / _CELL_M, stamps_s, self.last_s) >= _FEWEST


@jit
def _crossed(world: Points, stamps_s: Floats, last_s: Floats) -> Ints:
    counts = np.zeros(len(world), np.int64)
    rows, columns = last_s.shape
    for i in range(world.shape[0]):
        for j in range(world.shape[1]):
            x, y = world[i, j].real, world[i, j].imag
            if 0.0 <= x < columns and 0.0 <= y < rows:  # false for NaN
                counts[i] += last_s[int(y), int(x)] > stamps_s[i] + _LATER_S
    return counts


def _loose(scans: Scans, world: Points) -> Series:
    """Return how far the fastest compact thing went from one scan to the next [m]."""
    now, before = _apart(scans.stamps_s, _NEXT_S)
    around = 2.0 * np.pi / np.abs(scans.angle_increment.ravel())
    closed = np.abs(around - scans.ranges.shape[1]) < _GAP_RAYS
    return Series(scans.times_s[now], _fastest(scans.ranges, world, closed, now, before))


@jit
def _fastest(ranges: Floats, world: Points, closed: Bools, now: Ints, before: Ints) -> Floats:
    size = ranges.shape[1]
    centres = np.full((len(ranges), size), np.nan + 0j)
    for n in range(len(ranges)):
        for k, (first, after) in enumerate(_compact(ranges[n], closed[n])):
            total = 0j
            for i in range(first, after):
                total += world[n, i % size]
            centres[n, k] = total / (after - first)
    fastest = np.full(len(now), np.nan)
    for k in range(len(now)):
        for here in centres[now[k]]:
            if np.isnan(here.real):
                break
            gone = math.inf
            for there in centres[before[k]]:
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
    """Return first and one past last ray of the things that stand free in a scan, shape (n, 2).

    In a scan that closes around, rays are counted on past its end.
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
            found[count] = start, i
            count += 1
        if i >= size:
            break
        start = i
    return found[:count]
