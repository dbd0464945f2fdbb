"""Whether laser scans agree with the map, seen from the estimated pose of the robot.

The map is used as one more scanner: rays are cast through it from each scan's pose, and the two are
compared as in ``redundancy``. A return in front of the map's is an obstacle that the map does not
have, real or fake. One behind it went through a wall. Unknown cells of the map are ignored.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import header_stamps_s, poses_of
from oracle_pipeline.features.geometry.grid_hits import CELL_M, MOST_HITS, HitCounter, Hits
from oracle_pipeline.features.geometry.odometry_path import OdometryPath
from oracle_pipeline.features.geometry.planar_pose import PlanarPose, PosePath
from oracle_pipeline.features.geometry.scan_agreement import (
    CLOSER_M,
    agreement,
    contradicted_shares,
)
from oracle_pipeline.features.geometry.scan_projection import project
from oracle_pipeline.features.geometry.scanner_setup import (
    SETUP_TOPICS,
    ScannerSetup,
    scanner_setup,
)
from oracle_pipeline.features.geometry.scans import Bools, Floats, Ints, Points, in_blocks
from oracle_pipeline.features.statistics.reduction import largest, quantile, row_medians, within
from oracle_pipeline.robots.roles import MAP, POSE

FEATURES = (
    fp.Feature("residual", "m", 5e-3,
        "distance from a return to the nearest obstacle of the map at its bearing, median, maximum "
        "over the scanners", "navigation"),
    fp.Feature("unexpected", "1", 5e-3,
        f"share of a scan's returns {CLOSER_M} m or more in front of the map's obstacles, 95th "
        "percentile, maximum over the scanners", "navigation"),
    fp.Feature("unexpected_persistence", "1", 0.01,
        f"share of the scans with returns as in unexpected in the same {CELL_M} m grid cell, "
        "maximum over the cells and scanners", "navigation"),
    fp.Feature("looked_through", "1", 5e-3,
        f"share of the map's visible obstacles for which a scan measures {CLOSER_M} m or more "
        "behind them, 95th percentile, maximum over the scanners", "navigation"),
)  # fmt: skip

_OCCUPIED = 65  # of 100, least value of a solid cell; Nav2's default threshold
_PERIOD_S = 0.35  # between the compared scans: neither the map nor a pose changes faster
# A ray advances by the clearance of its cell's centre, less half a diagonal of that cell and half a
# diagonal of the blocked one [cells].
_DIAGONAL = math.sqrt(2.0)
_SHORTEST_STEP = 0.35


@dataclass(frozen=True, slots=True)
class Map:
    """An occupancy grid to cast rays through."""

    pose: PlanarPose  # of the outer corner of cell (0, 0), in the map frame
    resolution: float  # edge of a cell [m]
    clearance: NDArray[np.float32]  # to the nearest solid or unknown cell, shape (rows, columns)
    solid: NDArray[np.bool_]

    @classmethod
    def of(cls, grid: "MapGrid") -> "Map":
        """Prepare a grid; everything outside its border is unknown."""
        from scipy.ndimage import distance_transform_edt  # many recordings have no map

        cells = np.pad(grid.cells, 1, constant_values=-1)
        solid = cells >= _OCCUPIED
        clearance = distance_transform_edt((cells >= 0) & ~solid).astype(np.float32)
        return cls(grid.pose, grid.resolution, clearance, solid)

    def cast(self, origins: Points, directions: Points) -> Floats:
        """Return the distances along rays to the first solid cell [m].

        Parameters
        ----------
        origins, directions : ndarray of shape (n, m)
            Starting points and unit vectors of the rays, in the map frame.

        Returns
        -------
        ndarray of shape (n, m)
            NaN for rays that reach an unknown cell first.
        """
        inverse = self.pose.inverse()
        start = inverse.apply(origins) / self.resolution + (1.0 + 1.0j)  # the padding
        start, step = map(np.array, np.broadcast_arrays(start, inverse.rotate(directions)))
        return _march(start, step, self.clearance, self.solid) * self.resolution


@jit
def _march(start: Points, step: Points, clearance: NDArray[np.float32], solid: Bools) -> Floats:
    """Advance the rays of a scan in turn: a step waits for the last one of its own ray only."""
    reached = np.full(start.shape, np.nan)
    rows, columns = clearance.shape
    rays = start.shape[1]
    for i in range(start.shape[0]):
        x, y, gone = start[i].real.copy(), start[i].imag.copy(), np.zeros(rays)
        going, count = np.arange(rays), rays
        while count:
            still = 0
            for j in going[:count]:
                if not (0.0 <= x[j] < columns and 0.0 <= y[j] < rows):
                    continue
                row, column = int(y[j]), int(x[j])
                free = clearance[row, column]
                if free == 0.0:
                    if solid[row, column] and gone[j] > 0.0:  # else it begins in a solid cell
                        reached[i, j] = gone[j]
                    continue
                ahead = max(free - _DIAGONAL, _SHORTEST_STEP)
                x[j] += ahead * step[i, j].real
                y[j] += ahead * step[i, j].imag
                gone[j] += ahead
                going[still] = j
                still += 1
            count = still
    return reached


class MapGrid(NamedTuple):
    """The part of a ``nav_msgs/msg/OccupancyGrid`` that is kept."""

    pose: PlanarPose  # of the outer corner of cell (0, 0)
    resolution: float  # [m]
    cells: NDArray[np.int8]  # shape (rows, columns), 0 free to 100 solid, -1 unknown


@dataclass(frozen=True, slots=True)
class _Consistency:
    """Comparison of each used scan of a scanner with the map."""

    residual: fp.Series  # [m]
    unexpected: fp.Series
    looked_through: fp.Series
    hits: Hits | fp.Missing


def prepare(window: fp.Window) -> dict[str, _Consistency] | fp.Missing:
    """Compare every scanner with the map, over the whole recording."""
    grids, poses = fp.sole_series(window.topics["map"]), fp.sole_series(window.topics["poses"])
    setup = scanner_setup(window)
    if grids is None or poses is None:
        return fp.Missing("no map" if grids is None else "no pose of localisation")
    if setup.motion is None:
        return fp.Missing("no odometry")
    world = Map.of(grids.values[-1])
    correction = _correction(poses, setup.motion)
    return {topic: _compared_with_map(world, correction, setup, topic) for topic in setup.mounts}


def compute(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    residual, unexpected, persistence, through = {}, {}, {}, {}
    consistency: dict[str, _Consistency] = window.prepared
    for topic, each in consistency.items():
        residual[topic] = quantile(each.residual, window, 0.5)
        unexpected[topic] = quantile(each.unexpected, window, 0.95)
        if isinstance(each.hits, Hits):
            scans_within = within(each.residual.times_s, window)
            persistence[topic] = each.hits.persistence(scans_within)
        through[topic] = quantile(each.looked_through, window, 0.95)
    reason = "no horizontal laser scanner measured in the known part of the map"
    return {
        "residual": largest(residual, reason),
        "unexpected": largest(unexpected, reason),
        "unexpected_persistence": largest(persistence, reason),
        "looked_through": largest(through, reason),
    }


def keep_grids(messages: Any) -> list[MapGrid]:
    """Keep the cells of grids and their poses."""
    info = messages.info
    columns = *poses_of(info.origin), info.resolution, info.height, info.width
    grids = []
    for (*pose, edge, rows, width), data in zip(
        zip(*(column.tolist() for column in columns), strict=True), messages.data, strict=True
    ):
        x, y, yaw = pose
        planar = PlanarPose(np.asarray(complex(x, y)), np.asarray(np.exp(1j * yaw)))
        grids.append(MapGrid(planar, edge, data.reshape(rows, width)))
    return grids


def _correction(poses: fp.Series, motion: OdometryPath) -> PosePath:
    """Return the pose of the odometry frame in the map from localisation."""
    stamps_s, *believed = np.array(sorted(poses.values.tolist())).T
    pose = PlanarPose.of(*believed).compose(motion.base(stamps_s).inverse())
    return PosePath.through(stamps_s, pose)


def _keep_believed(messages: Any) -> tuple[Floats, Floats, Floats, Floats]:
    """Return stamp and pose of ``geometry_msgs/msg/PoseWithCovarianceStamped``s."""
    return header_stamps_s(messages), *poses_of(messages.pose.pose)


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of scans and map."""
    topics = SETUP_TOPICS | {
        "map": fp.Request(
            keep_grids, role=MAP, dtype=object, optional=True, many=True, carried=True
        ),
        "poses": fp.Request(_keep_believed, role=POSE, optional=True, many=True, carried=True),
    }
    return [fp.FeaturePlugin("map_consistency", "map", FEATURES, compute, topics, prepare=prepare)]


def _compared_with_map(
    world: Map, correction: PosePath, setup: ScannerSetup, topic: str
) -> _Consistency:
    scans = setup.scanners[topic]
    rows = _spaced(scans.stamps_s)
    stamps_s, times_s = scans.stamps_s[rows], scans.times_s[rows]
    placed = correction.at(stamps_s).compose(setup.poses(setup.mounts[topic], stamps_s))

    counter = HitCounter(MOST_HITS // len(setup.mounts))

    def compared(part: slice) -> tuple[Floats, Floats, Floats]:
        some, here = scans.rows(rows[part]), placed.at(part)
        columns = here.columns()
        ranges = world.cast(columns.translation, columns.rotate(some.rays_along()))
        charted = replace(some, range_max=np.inf, ranges=ranges)
        points = some.points()
        returned = agreement(points, charted)
        counter.add(project(some, here), returned.contradicted, part.start)
        return (
            row_medians(returned.residual),
            returned.contradicted_share(),
            contradicted_shares(charted.points(), some),
        )

    residual, unexpected, through = in_blocks(len(rows), scans.rays, compared)
    return _Consistency(
        fp.Series(times_s, residual),
        fp.Series(times_s, unexpected),
        fp.Series(times_s, through),
        counter.hits(),
    )


def _spaced(stamps_s: Floats) -> Ints:
    """Return the indices of stamps, the first in each span of `_PERIOD_S`."""
    _, first = np.unique(np.floor(stamps_s / _PERIOD_S), return_index=True)
    return first
