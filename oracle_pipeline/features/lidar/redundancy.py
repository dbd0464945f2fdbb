"""Whether sensors that measure the same scene agree: laser scanners and range sensors.

Every scanner is compared with every other one, given their mounts in ``/tf_static`` and the motion
of the robot between their scans. A real object is seen by all of them. If another scanner measures
through a return, the return is false or the other scanner is blind to it. Both are the same
contradiction, seen from either side, so the largest value over the ordered pairs covers both. No
topic is trusted, and none is named.
"""

from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s
from oracle_pipeline.features.geometry.grid_hits import CELL_M, MOST_HITS, HitCounter, Hits
from oracle_pipeline.features.geometry.scan_agreement import CLOSER_M, agreement
from oracle_pipeline.features.geometry.scan_projection import project
from oracle_pipeline.features.geometry.scanner_setup import (
    SETUP_TOPICS,
    ScannerSetup,
    scanner_setup,
)
from oracle_pipeline.features.geometry.scans import Floats, Ints, in_blocks
from oracle_pipeline.features.geometry.transform_tree import SensorMount
from oracle_pipeline.features.statistics import reduction
from oracle_pipeline.features.statistics.times import nearest

_SCANNER_FEATURES = (
    fp.Feature("scan_residual", "m", 1e-3,
        "distance from a return to the nearest return of another scanner, median, maximum over the "
        "pairs of scanners", "domain"),
    fp.Feature("scan_contradicted", "1", 2e-3,
        f"share of a scan's returns for which another scanner measures {CLOSER_M} m or more behind "
        "them, 95th percentile, maximum over the pairs of scanners", "domain"),
    fp.Feature("scan_persistence", "1", 0.01,
        f"share of the scans with returns as in scan_contradicted in the same {CELL_M} m grid "
        "cell, maximum over the cells and the pairs of scanners", "domain"),
)  # fmt: skip
_RANGE_FEATURES = (
    fp.Feature("range_residual", "m", 5e-3,
        "absolute difference between a Range sensor and the nearest return of a laser scanner in "
        "its field of view, median, maximum over the pairs", "domain"),
    fp.Feature("range_contradicted", "1", 5e-3,
        f"share of the Range messages whose range_residual is above {CLOSER_M} m, maximum over "
        "the pairs",
        "domain"),
)  # fmt: skip

_SIMULTANEOUS_S = 0.15  # most between compared measurements


@dataclass(frozen=True, slots=True)
class _Comparison:
    """Comparison of a scanner with another, by the times of the first one's scans."""

    residual: fp.Series  # median of each scan [m]
    contradicted: fp.Series  # share of each scan
    hits: Hits | fp.Missing  # cells of the odometry frame with contradicted returns


def _prepare_scanners(window: fp.Window) -> dict[str, _Comparison] | fp.Missing:
    """Compare every scanner with every other, over the whole recording."""
    setup = scanner_setup(window)
    if len(setup.scanners) < 2:
        return fp.Missing("fewer than two laser scanners are recorded")
    pairs = [
        (suspect, other)
        for suspect, other in permutations(setup.mounts, 2)
        if setup.mounts[suspect].root == setup.mounts[other].root
    ]
    return {
        f"{suspect} against {other}": _compared_with(setup, suspect, other, MOST_HITS // len(pairs))
        for suspect, other in pairs
    } or fp.Missing("/tf_static connects no two horizontal laser scanners")


def _compute_scanners(window: fp.Window) -> fp.Values:
    """Reduce the comparisons to the window."""
    comparisons: dict[str, _Comparison] = window.prepared
    apart = "no two scanners measured the same area at the same time"
    residual, contradicted, persistence = {}, {}, {}
    reason = apart
    for pair, comparison in comparisons.items():
        residual[pair] = reduction.quantile(comparison.residual, window, 0.5)
        contradicted[pair] = reduction.quantile(comparison.contradicted, window, 0.95)
        if isinstance(comparison.hits, fp.Missing):
            reason = comparison.hits.reason
        else:
            scans = reduction.within(comparison.residual.times_s, window)
            persistence[pair] = comparison.hits.persistence(scans)
    return {
        "scan_residual": reduction.largest(residual, apart),
        "scan_contradicted": reduction.largest(contradicted, apart),
        "scan_persistence": reduction.largest(persistence, reason),
    }


def _prepare_ranges(window: fp.Window) -> dict[str, fp.Series] | fp.Missing:
    """Return each range minus the nearest return in its cone [m], by pair of topics."""
    setup = scanner_setup(window)
    ranges = window.topics["ranges"]
    mounts = {topic: setup.tree.mount(series.values[0][1]) for topic, series in ranges.items()}
    return {
        f"{topic} against {scanner}": _beyond(setup, ranges[topic], mount, scanner)
        for (topic, mount), scanner in product(mounts.items(), setup.mounts)
        if mount.pose is not None and mount.root == setup.mounts[scanner].root
    } or fp.Missing("/tf_static connects no horizontal range sensor and laser scanner")


def _compute_ranges(window: fp.Window) -> fp.Values:
    """Reduce the differences to the window."""
    differences: dict[str, fp.Series] = window.prepared
    residual, contradicted = {}, {}
    for pair, (times_s, beyond_m) in differences.items():
        size = np.abs(beyond_m)
        beyond = np.where(np.isnan(size), np.nan, size > CLOSER_M)
        residual[pair] = reduction.quantile(fp.Series(times_s, size), window, 0.5)
        contradicted[pair] = reduction.mean(fp.Series(times_s, beyond), window)
    silent = "no laser scan covers the field of view of a range sensor at the same time"
    return {
        "range_residual": reduction.largest(residual, silent),
        "range_contradicted": reduction.largest(contradicted, silent),
    }


def _keep_ranges(messages: Any) -> tuple[Any, ...]:
    """Return stamp, frame, field of view, limits and range of ``sensor_msgs/msg/Range``s."""
    return (
        header_stamps_s(messages), frame_names(messages.header.frame_id), messages.field_of_view,
        messages.min_range, messages.max_range, messages.range,
    )  # fmt: skip


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of redundant sensors."""
    ranges = {
        "ranges": fp.Request(_keep_ranges, msgtype="sensor_msgs/msg/Range", dtype=object, many=True)
    }
    return [
        fp.FeaturePlugin(
            "redundant_scanners", "redundancy", _SCANNER_FEATURES, _compute_scanners, SETUP_TOPICS,
            prepare=_prepare_scanners,
        ),
        fp.FeaturePlugin(
            "redundant_ranges", "redundancy", _RANGE_FEATURES, _compute_ranges,
            SETUP_TOPICS | ranges, prepare=_prepare_ranges,
        ),
    ]  # fmt: skip


def _compared_with(setup: ScannerSetup, suspect: str, other: str, most_hits: int) -> _Comparison:
    scans, reference = setup.scanners[suspect], setup.scanners[other]
    rows, reference_rows = _simultaneous(scans.stamps_s, reference.stamps_s)
    placed = setup.poses(setup.mounts[suspect], scans.stamps_s[rows])
    reference_placed = setup.poses(setup.mounts[other], reference.stamps_s[reference_rows])
    in_reference = reference_placed.inverse().compose(placed)

    counter = HitCounter(most_hits)

    def compared(part: slice) -> tuple[Floats, Floats]:
        some = scans.rows(rows[part])
        seen = project(some, in_reference.at(part))
        agreed = agreement(seen, reference.rows(reference_rows[part]))
        counter.add(project(some, placed.at(part)), agreed.contradicted, part.start)
        return reduction.row_medians(agreed.residual), agreed.contradicted_share()

    residual, contradicted = in_blocks(len(rows), scans.rays, compared)
    times_s = scans.times_s[rows]
    return _Comparison(
        fp.Series(times_s, residual),
        fp.Series(times_s, contradicted),
        fp.Missing("no odometry") if setup.motion is None else counter.hits(),
    )


def _beyond(setup: ScannerSetup, ranges: fp.Series, mount: SensorMount, scanner: str) -> fp.Series:
    stamps_s, _, *columns = (np.array(column) for column in zip(*ranges.values, strict=True))
    scans = setup.scanners[scanner]
    rows, scan_rows = _simultaneous(stamps_s, scans.stamps_s)
    view, low, high, measured = (column[rows] for column in columns)
    sensor = setup.poses(mount, stamps_s[rows])
    placed = setup.poses(setup.mounts[scanner], scans.stamps_s[scan_rows])
    in_sensor = sensor.inverse().compose(placed)

    def nearest_in_cone(part: slice) -> tuple[Floats]:
        points = project(scans.rows(scan_rows[part]), in_sensor.at(part))
        in_cone = np.abs(np.angle(points)) <= view[part, np.newaxis] / 2.0
        return (np.where(in_cone, np.abs(points), np.inf).min(axis=1),)

    (closest,) = in_blocks(len(rows), scans.rays, nearest_in_cone)
    closest = np.where(np.isinf(closest), np.nan, np.clip(closest, low, high))
    measured = np.where(measured < low, np.nan, np.minimum(measured, high))
    return fp.Series(ranges.times_s[rows], measured - closest)


def _simultaneous(stamps_s: Floats, others_s: Floats) -> tuple[Ints, Ints]:
    """Return the indices of the stamps with a simultaneous one, and of that one."""
    order = np.argsort(others_s, kind="stable")
    nearest_other = order[nearest(others_s[order], stamps_s)]
    close = np.flatnonzero(np.abs(others_s[nearest_other] - stamps_s) <= _SIMULTANEOUS_S)
    return close, nearest_other[close]
