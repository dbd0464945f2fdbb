"""Agreement of points with a laser scan: how near its returns are, and which points it contradicts.

What the agreement is used for stands in ``redundancy`` (two sensors), ``scan`` (one sensor, two
times) and ``map_consistency`` (a sensor and the map).
"""

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from oracle_pipeline.bags.jit import jit, jit_unchecked
from oracle_pipeline.features.geometry.polar import distances, rays
from oracle_pipeline.features.geometry.scans import Bools, Floats, Ints, Points, Scans

CLOSER_M = 0.3  # by which a return must be nearer than another to contradict it
_NEIGHBOURS = 2  # rays on each side of a point's own that may explain it
_WIDTH = 2 * _NEIGHBOURS + 1


class Agreement(NamedTuple):
    """Agreement of points with another sensor's returns; shape (n, m)."""

    residual: Floats  # from the point to the nearest return within two bearings [m]; NaN: none
    signed: Floats  # point less return at its own bearing [m]; NaN: none
    contradicted: Bools  # the other sensor measured through the point
    compared: Bools  # the other sensor has a ray there

    def contradicted_share(self) -> Floats:
        """Return the share of each scan's compared points that are contradicted, shape (n,)."""
        return _shares(self.contradicted, self.compared)


def agreement(points: Points, reference: Scans) -> Agreement:
    """Compare points with scans.

    A point is contradicted if every ray of the reference within two bearings of it goes on for
    `CLOSER_M` behind it. A closer return hides a point and does not count.

    Parameters
    ----------
    points : ndarray of shape (n, m)
        In the frame of the reference's sensor; row i belongs to its scan i.
    reference : Scans
        n scans.
    """
    return Agreement(*_agreement(points, *_arrays(reference)))


def contradicted_shares(points: Points, reference: Scans) -> Floats:
    """Return only the ``contradicted_share`` of an `agreement`, which takes half as long."""
    return _contradicted_shares(points, *_arrays(reference))


def _arrays(scans: Scans) -> tuple[Floats, Floats, Floats, float]:
    return scans.ranges, scans.angle_min.ravel(), scans.angle_increment.ravel(), scans.range_max


@jit
def _shares(flags: Bools, known: Bools) -> Floats:
    """Return the share of some flags in the known ones, row by row; NaN for a row without any."""
    shares = np.full(len(flags), np.nan)
    for i in range(len(flags)):
        count = total = 0
        for j in range(flags.shape[1]):
            count += flags[i, j]
            total += known[i, j]
        if total:
            shares[i] = count / total
    return shares


@jit
def _agreement(
    points: Points, ranges: Floats, angle_min: Floats, angle_increment: Floats, range_max: float
) -> tuple[Floats, Floats, Bools, Bools]:
    residual, signed = np.empty(points.shape), np.empty(points.shape)
    contradicted, compared = np.empty(points.shape, np.bool_), np.empty(points.shape, np.bool_)
    match = _empty_match(points.shape[1], ranges.shape[1])
    for i in range(points.shape[0]):
        _associate(points[i], ranges[i], angle_min[i], angle_increment[i], range_max, match)
        _compare(match, residual[i], signed[i], contradicted[i], compared[i])
    return residual, signed, contradicted, compared


@jit
def _contradicted_shares(
    points: Points, ranges: Floats, angle_min: Floats, angle_increment: Floats, range_max: float
) -> Floats:
    shares = np.full(len(points), np.nan)
    match = _empty_match(points.shape[1], ranges.shape[1])
    for i in range(points.shape[0]):
        _associate(points[i], ranges[i], angle_min[i], angle_increment[i], range_max, match)
        contradicted, compared = _contradictions(match)
        if compared:
            shares[i] = contradicted / compared
    return shares


#: The association of points with the rays of a scan, see `_associate`: distances of the points
#: [m]; where their neighbours begin; ranges of the scan [m]; free range of each neighbourhood [m].
_Match: TypeAlias = tuple[Floats, Ints, Floats, Floats]


@jit
def _empty_match(points: int, rays: int) -> _Match:
    """Return the arrays to associate some points with some rays."""
    most = rays + 3 * _WIDTH
    return np.empty(points), np.empty(points, np.int64), np.empty(most), np.empty(most)


@jit
def _associate(
    points: Points, ranges: Floats, start: float, increment: float, range_max: float, match: _Match
) -> None:
    """Write the distance of each point, and which rays of the scan are its neighbours.

    The neighbours of a point are `_WIDTH` ranges of the padded scan, from its index on.
    """
    distance, neighbours, padded, free = match
    circle = max(1, round(2.0 * math.pi / abs(increment)))  # bearings around
    x, y = points.real.copy(), points.imag.copy()  # side by side, several at a time
    distances(x, y, distance)
    rays(x, y, start, increment, neighbours)
    without = _pad(ranges, circle, range_max, padded, free)
    for j in range(len(neighbours)):
        last = neighbours[j] + _NEIGHBOURS
        if not 0 <= last < circle:
            last %= circle
        neighbours[j] = min(last, without)


@jit
def _pad(ranges: Floats, circle: int, range_max: float, padded: Floats, free: Floats) -> int:
    """Write the ranges of a scan so that each neighbourhood is a slice; return an index of none.

    A neighbourhood has the index of its last ray. ``padded`` has its ranges from there on; ``free``
    is the least of them and of ``range_max``, NaN if one is NaN. All are NaN at the index that is
    returned, which is for points without any neighbour.
    """
    rays = len(ranges)
    count = min(circle, rays + _WIDTH - 1)
    ray = (1 - _WIDTH) % circle
    for index in range(count + _WIDTH - 1):
        padded[index] = ranges[ray] if ray < rays else math.nan
        ray = ray + 1 if ray + 1 < circle else 0
    without = count + _WIDTH - 1
    padded[without : without + _WIDTH] = math.nan
    free[count : without + 1] = math.nan
    farthest = -math.inf if math.isnan(range_max) else range_max
    for index in range(count):
        least, all_valid = farthest, True
        for neighbour in range(_WIDTH):
            measured = padded[index + neighbour]
            least = min(least, measured)
            all_valid &= measured == measured  # not NaN
        free[index] = least if all_valid else math.nan
    return without


@jit_unchecked
def _compare(
    match: _Match, residual: Floats, signed: Floats, contradicted: Bools, compared: Bools
) -> None:
    """Write the fields of `Agreement` for the points of a scan, without any branch."""
    distances_m, neighbours, padded, free = match
    for j in range(len(distances_m)):
        distance, first = distances_m[j], neighbours[j]
        nearest = math.inf
        for neighbour in range(_WIDTH):
            gap = abs(distance - padded[first + neighbour])
            nearest = gap if gap < nearest else nearest  # false for NaN
        residual[j] = nearest if nearest < math.inf else math.nan
        measured = padded[first + _NEIGHBOURS]
        signed[j] = distance - measured if measured < math.inf else math.nan
        compared[j] = not math.isnan(distance + free[first])
        contradicted[j] = distance + CLOSER_M < free[first]


@jit_unchecked
def _contradictions(match: _Match) -> tuple[int, int]:
    """Return how many points of a scan are contradicted, and how many compared."""
    distances_m, neighbours, _, free = match
    contradicted = compared = 0
    for j in range(len(distances_m)):
        compared += not math.isnan(distances_m[j] + free[neighbours[j]])
        contradicted += distances_m[j] + CLOSER_M < free[neighbours[j]]
    return contradicted, compared
