"""Rates at which obstacles appear and disappear in the local costmap.

The costmap moves with the robot, so two grids are compared where they overlap.
"""

from itertools import pairwise

import numpy as np

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.lidar.map_consistency import MapGrid, keep_grids
from oracle_pipeline.features.statistics.reduction import within
from oracle_pipeline.robots.roles import LOCAL_COSTMAP

FEATURES = fp.timed(
    fp.Feature("lethal_appearing", "1/s", 1.0,
        "cells of the local costmap that become lethal per second, mean", "navigation"),
    fp.Feature("lethal_vanishing", "1/s", 1.0, "cells that cease to be lethal per second, mean",
        "navigation"),
)  # fmt: skip

LETHAL = 100  # value of a cell
GRIDS = fp.Request(keep_grids, role=LOCAL_COSTMAP, dtype=object, many=True)


def changes(before: MapGrid, now: MapGrid) -> tuple[int, int]:
    """Count the cells that became lethal, and those that ceased to be, where the grids overlap."""
    offset = complex(before.pose.inverse().apply(now.pose.translation) / before.resolution)
    if not np.isfinite(offset):
        return 0, 0
    rows = _shared(round(offset.imag), len(before.cells), len(now.cells))
    columns = _shared(round(offset.real), before.cells.shape[1], now.cells.shape[1])
    was, became = (
        grid.cells[row, column] == LETHAL
        for grid, row, column in zip((before, now), rows, columns, strict=True)
    )
    return int((became & ~was).sum()), int((was & ~became).sum())


def prepare(window: fp.Window) -> fp.Series | fp.Missing:
    """Return cells that become lethal, that cease to be, and seconds, between two grids; (n, 3)."""
    ((times_s, grids),) = window.topics["grids"].values()
    if len(times_s) < 2:
        return fp.Missing("fewer than two costmaps")
    counts = np.array([changes(*pair) for pair in pairwise(grids)])
    return fp.Series(times_s[1:], np.column_stack([counts, np.diff(times_s)]))


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Reduce to the window: a latched grid may be followed by the next one at once."""
    steps: fp.Series = window.prepared
    appearing, vanishing, passed_s = steps.values[within(steps.times_s, window)].sum(axis=0)
    if not passed_s > 0.0:
        return fp.Missing("no two costmaps in this window")
    return {"lethal_appearing": appearing / passed_s, "lethal_vanishing": vanishing / passed_s}


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of the local costmap."""
    return [
        fp.FeaturePlugin(
            "local_costmap", "navigation", FEATURES, compute, {"grids": GRIDS}, prepare=prepare
        )
    ]


def _shared(offset: int, before: int, now: int) -> tuple[slice, slice]:
    """Return the overlap of two rows of cells, as slices; the second begins at an offset."""
    start = max(0, offset)
    stop = max(start, min(before, offset + now))
    return slice(start, stop), slice(start - offset, stop - offset)
