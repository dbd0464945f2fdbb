"""Whether the local costmap has the obstacles that the laser scanners detect.

A scanner's returns are projected into the costmap recorded with the scan, using the pose from
odometry. With obstacles missing from the costmap, the robot drives into them though its scans are
correct.
"""

import math

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scan_projection import project
from oracle_pipeline.features.geometry.scanner_setup import (
    SETUP_TOPICS,
    ScannerSetup,
    scanner_setup,
)
from oracle_pipeline.features.geometry.scans import Floats, Points, in_blocks
from oracle_pipeline.features.lidar.local_costmap import GRIDS, LETHAL
from oracle_pipeline.features.lidar.map_consistency import MapGrid
from oracle_pipeline.features.statistics.reduction import largest, mean

FEATURES = (
    fp.Feature("unmarked", "1", 0.02,
        "share of a scan's returns inside the local costmap with no lethal cell at or next to "
        "them, mean, maximum over the scanners", "navigation"),
)  # fmt: skip

_FEWEST = 5  # returns inside the costmap; with fewer, the share is NaN


def prepare(window: fp.Window) -> dict[str, fp.Series] | fp.Missing:
    """Project the returns of every scanner into the costmaps, over the whole recording."""
    ((times_s, grids),) = window.topics["grids"].values()
    setup = scanner_setup(window)
    if setup.motion is None:
        return fp.Missing("no odometry")
    return {topic: _unmarked(setup, topic, times_s, grids) for topic in setup.mounts}


def _unmarked(
    setup: ScannerSetup, topic: str, times_s: Floats, grids: NDArray[np.object_]
) -> fp.Series:
    scans = setup.scanners[topic]
    rows = np.searchsorted(scans.times_s, times_s, side="right") - 1
    seen = np.flatnonzero(rows >= 0)
    rows = rows[seen]
    placed = setup.poses(setup.mounts[topic], scans.stamps_s[rows])

    def compared(part: slice) -> tuple[Floats]:
        returns = project(scans.rows(rows[part]), placed.at(part))
        both = zip(grids[seen[part]], returns, strict=True)
        return (np.array([unmarked(*each) for each in both], dtype=np.float64),)

    (shares,) = in_blocks(len(rows), scans.rays, compared)
    return fp.Series(times_s[seen], shares)


def unmarked(grid: MapGrid, returns: Points) -> float:
    """Return the share of the points inside a costmap that are not within a cell of a lethal one.

    Parameters
    ----------
    grid : MapGrid
    returns : ndarray of shape (n,)
        In the costmap's frame [m]; NaN where there was no return.

    Returns
    -------
    float
        NaN if fewer than five points are inside.
    """
    cells = grid.pose.inverse().apply(returns) / grid.resolution
    return _unmarked_share(cells, grid.cells)


@jit
def _unmarked_share(places: Points, cells: NDArray[np.int8]) -> float:
    rows, columns = cells.shape
    inside = marked = 0
    for place in places:
        x, y = math.floor(place.real), math.floor(place.imag)
        if not (0.0 <= place.real < columns and 0.0 <= place.imag < rows):  # NaN, too
            continue
        inside += 1
        is_marked = False
        for row in range(max(0, y - 1), min(rows, y + 2)):
            for column in range(max(0, x - 1), min(columns, x + 2)):
                is_marked |= cells[row, column] == LETHAL
        marked += is_marked
    return 1.0 - marked / inside if inside >= _FEWEST else math.nan


def compute(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    shares: dict[str, fp.Series] = window.prepared
    means = {topic: mean(series, window) for topic, series in shares.items()}
    return {"unmarked": largest(means, "no horizontal laser scanner has returns in the costmap")}


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of scans and costmap."""
    topics = SETUP_TOPICS | {"grids": GRIDS}
    return [
        fp.FeaturePlugin(
            "costmap_consistency", "costmap", FEATURES, compute, topics, prepare=prepare
        )
    ]
