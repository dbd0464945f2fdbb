"""Poses of laser scanners, and the agreement of one scan with another.

Points are complex numbers, x + iy [m], so that to move them is to multiply and add. What the
agreement is used for stands in ``redundancy`` (two sensors), ``scan`` (one sensor, two times) and
``map_consistency`` (a sensor and the map).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit, jit_unchecked
from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s, poses_of
from oracle_pipeline.features.engine.plugin import Missing, Request, Series, Window
from oracle_pipeline.features.geometry.polar import distances, rays
from oracle_pipeline.features.geometry.scans import (
    SCANS,
    Bools,
    Floats,
    Ints,
    Points,
    RecordedScans,
    Scans,
)
from oracle_pipeline.robots.roles import ODOMETRY, STATIC_TRANSFORMS

CLOSER_M = 0.3  # by which a return must be nearer than another to contradict it
CELL_M = 0.25  # edge of the cells in which contradictions are counted
_FARTHEST_CELL = 2**30
MOST_HITS = 2**23  # limit for one plugin and recording
_NEIGHBOURS = 2  # rays on each side of a point's own that may explain it
_WIDTH = 2 * _NEIGHBOURS + 1
#: Distances and places of points, and what another scan has there: see `_lap`.
_Met: TypeAlias = tuple[Floats, Ints, Floats, Floats]

_MOST_SCANNERS = 24  # of one robot; each is compared with every other one
_TILTED = 0.99  # determinant of a rotation's upper left block below which a scan plane is tilted


class Planar(NamedTuple):
    """Poses in a plane, one or many: ``p -> shift + turn * p``, mirrored first if flipped.

    A scanner that hangs upside down is flipped.
    """

    shift: Points  # [m]
    turn: Points  # exp(i yaw)
    flipped: bool = False

    def apply(self, points: Points) -> Points:
        """Return points of the child frame in the parent frame."""
        return self.shift + self.turn * (points.conj() if self.flipped else points)

    def compose(self, child: "Planar") -> "Planar":
        """Return the pose of ``child``'s child in this one's parent."""
        turn = child.turn.conj() if self.flipped else child.turn
        return Planar(self.apply(child.shift), self.turn * turn, self.flipped != child.flipped)

    def inverse(self) -> "Planar":
        """Return the pose of the parent in the child."""
        if self.flipped:
            return Planar(-self.turn * self.shift.conj(), self.turn, flipped=True)
        return Planar(-self.turn.conj() * self.shift, self.turn.conj())

    def at(self, index: slice | Ints) -> "Planar":
        """Return some of many poses."""
        return Planar(self.shift[index], self.turn[index], self.flipped)

    def columns(self) -> "Planar":
        """Return the poses as columns, to apply each to a row of points."""
        shift, turn = (np.asarray(part)[..., np.newaxis] for part in self[:2])
        return Planar(shift, turn, self.flipped)

    def returns(self, scans: Scans) -> Points:
        """Return the ends of rays in the parent frame, shape (n, m); NaN without a return.

        Pose i is that of the sensor at scan i.
        """
        return _placed(scans.ranges, scans.rays_along(), self.shift, self.turn, self.flipped)


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
    return Agreement(*_agree(points, *_measured(reference)))


def contradicted_shares(points: Points, reference: Scans) -> Floats:
    """Return only the ``contradicted_share`` of an `agreement`, which takes half as long."""
    return _contradicted_shares(points, *_measured(reference))


def _measured(scans: Scans) -> tuple[Floats, Floats, Floats, float]:
    return scans.ranges, scans.angle_min.ravel(), scans.angle_increment.ravel(), scans.range_max


@jit
def _shares(flags: Bools, of: Bools) -> Floats:
    """Return the share of some flags in others, row by row; NaN for a row without any."""
    shares = np.full(len(flags), np.nan)
    for i in range(len(flags)):
        count = total = 0
        for j in range(flags.shape[1]):
            count += flags[i, j]
            total += of[i, j]
        if total:
            shares[i] = count / total
    return shares


@jit_unchecked
def _placed(
    ranges: Floats, rays_along: Points, shift: Points, turn: Points, flipped: bool
) -> Points:
    """Do as ``Planar.apply`` does with each row of points, without arrays between."""
    placed = np.empty(ranges.shape, np.complex128)
    for i in range(ranges.shape[0]):
        along = rays_along[i if len(rays_along) > 1 else 0]
        c, s = turn[i].real, turn[i].imag
        for j in range(ranges.shape[1]):
            distance = ranges[i, j] if abs(ranges[i, j]) < math.inf else math.nan
            x, y = distance * along[j].real, distance * along[j].imag
            y = -y if flipped else y
            placed[i, j] = complex(shift[i].real + (c * x - s * y), shift[i].imag + (c * y + s * x))
    return placed


@jit
def _agree(
    points: Points, ranges: Floats, angle_min: Floats, angle_increment: Floats, range_max: float
) -> tuple[Floats, Floats, Bools, Bools]:
    residual, signed = np.empty(points.shape), np.empty(points.shape)
    contradicted, compared = np.empty(points.shape, np.bool_), np.empty(points.shape, np.bool_)
    met = _room(points.shape[1], ranges.shape[1])
    for i in range(points.shape[0]):
        _meet(points[i], ranges[i], angle_min[i], angle_increment[i], range_max, met)
        _compare(met, residual[i], signed[i], contradicted[i], compared[i])
    return residual, signed, contradicted, compared


@jit
def _contradicted_shares(
    points: Points, ranges: Floats, angle_min: Floats, angle_increment: Floats, range_max: float
) -> Floats:
    shares = np.full(len(points), np.nan)
    met = _room(points.shape[1], ranges.shape[1])
    for i in range(points.shape[0]):
        _meet(points[i], ranges[i], angle_min[i], angle_increment[i], range_max, met)
        contradicted, compared = _contradictions(met)
        if compared:
            shares[i] = contradicted / compared
    return shares


@jit
def _room(points: int, rays: int) -> _Met:
    """Return the arrays for a scan of points and one of rays."""
    most = rays + 3 * _WIDTH
    return np.empty(points), np.empty(points, np.int64), np.empty(most), np.empty(most)


@jit
def _meet(
    points: Points, ranges: Floats, start: float, increment: float, range_max: float, met: _Met
) -> None:
    """Write the distances and places of points, and the rays of the other scan by place."""
    away, places, around, free = met
    circle = max(1, round(2.0 * math.pi / abs(increment)))  # bearings around
    x, y = points.real.copy(), points.imag.copy()  # side by side, several at a time
    distances(x, y, away)
    rays(x, y, start, increment, places)
    nowhere = _lap(ranges, circle, range_max, around, free)
    for j in range(len(places)):
        last = places[j] + _NEIGHBOURS
        if not 0 <= last < circle:
            last %= circle
        places[j] = min(last, nowhere)


@jit
def _lap(ranges: Floats, circle: int, range_max: float, around: Floats, free: Floats) -> int:
    """Write the rays of a scan, one after the other around the sensor; return how many places.

    The place of a point is the number of its last neighbour. ``around`` has the neighbours from
    there on; ``free`` is the least of them and of ``range_max``, NaN if one is NaN. All are NaN at
    the number that is returned, which is for points without any neighbour.
    """
    rays = len(ranges)
    places = min(circle, rays + _WIDTH - 1)
    ray = (1 - _WIDTH) % circle
    for place in range(places + _WIDTH - 1):
        around[place] = ranges[ray] if ray < rays else math.nan
        ray = ray + 1 if ray + 1 < circle else 0
    nowhere = places + _WIDTH - 1
    around[nowhere : nowhere + _WIDTH] = math.nan
    free[places : nowhere + 1] = math.nan
    farthest = -math.inf if math.isnan(range_max) else range_max
    for place in range(places):
        least, all_valid = farthest, True
        for neighbour in range(_WIDTH):
            measured = around[place + neighbour]
            least = min(least, measured)
            all_valid &= measured == measured  # not NaN
        free[place] = least if all_valid else math.nan
    return nowhere


@jit_unchecked
def _compare(
    met: _Met, residual: Floats, signed: Floats, contradicted: Bools, compared: Bools
) -> None:
    """Write the fields of `Agreement` for the points of a scan, without any branch."""
    away, places, around, free = met
    for j in range(len(away)):
        distance, place = away[j], places[j]
        apart = math.inf
        for neighbour in range(_WIDTH):
            gap = abs(distance - around[place + neighbour])
            apart = gap if gap < apart else apart  # false for NaN
        residual[j] = apart if apart < math.inf else math.nan
        measured = around[place + _NEIGHBOURS]
        signed[j] = distance - measured if measured < math.inf else math.nan
        compared[j] = not math.isnan(distance + free[place])
        contradicted[j] = distance + CLOSER_M < free[place]


@jit_unchecked
def _contradictions(met: _Met) -> tuple[int, int]:
    """Return how many points of a scan are contradicted, and how many compared."""
    away, places, _, free = met
    contradicted = compared = 0
    for j in range(len(away)):
        compared += not math.isnan(away[j] + free[places[j]])
        contradicted += away[j] + CLOSER_M < free[places[j]]
    return contradicted, compared


@dataclass(frozen=True, slots=True)
class Hits:
    """The cells of a grid that scans hit: each pair of scan and cell once."""

    scans: NDArray[np.int32]  # in order
    cells: NDArray[np.int32]  # any numbering

    def persistence(self, scans: slice) -> float:
        """Return the largest share of some scans that hit the same cell; NaN without scans."""
        if scans.start == scans.stop:
            return math.nan
        first, after = np.searchsorted(self.scans, (scans.start, scans.stop))
        counts = np.bincount(self.cells[first:after], minlength=1)
        return float(counts.max() / (scans.stop - scans.start))


class HitCounter:
    """Finds the hits of scans, block by block, up to a limit.

    Parameters
    ----------
    most : int
        Hits that are kept.
    """

    def __init__(self, most: int) -> None:
        self._blocks: list[Ints] = []
        self._left = most

    def add(self, points: Points, chosen: Bools, first: int) -> None:
        """Count chosen points, both of shape (n, m); the first row belongs to scan ``first``."""
        rows = _hits(points, chosen, first)
        self._left -= len(rows)
        if self._left >= 0:
            self._blocks.append(rows)
        else:
            self._blocks.clear()

    def hits(self) -> Hits | Missing:
        """Return the hits; `Missing` if there are too many."""
        if self._left < 0:
            return Missing("too many contradicted returns for the limit MOST_HITS")
        rows = np.concatenate([np.zeros((0, 2), np.int64), *self._blocks])
        _, cells = np.unique(rows[:, 1], return_inverse=True)
        return Hits(rows[:, 0].astype(np.int32), cells.reshape(-1).astype(np.int32))


@jit
def _hits(points: Points, chosen: Bools, first: int) -> Ints:
    """Return the scans and cells of chosen points, each pair once; shape (n, 2)."""
    found = np.empty((chosen.sum(), 2), np.int64)
    cells = np.empty(points.shape[1], np.int64)
    number = 0
    for i in range(points.shape[0]):
        count = 0
        for j in range(points.shape[1]):
            if chosen[i, j]:
                cells[count] = _cell(points[i, j].real) << 32 | _cell(points[i, j].imag)
                count += 1
        own = np.sort(cells[:count])
        for k in range(count):
            if k == 0 or own[k] != own[k - 1]:
                found[number] = first + i, own[k]
                number += 1
    return found[:number].copy()


@jit
def _cell(coordinate: float) -> int:
    """Return the number of a cell along an axis, from 0 on."""
    cell = min(max(coordinate / CELL_M, -_FARTHEST_CELL), _FARTHEST_CELL)  # fits an integer
    return math.floor(cell) + _FARTHEST_CELL


class SensorMount(NamedTuple):
    """The pose of a sensor on the robot; None if its plane is tilted."""

    root: str  # of the tree of frames
    pose: Planar | None


class Frames:
    """The tree of frames from static transforms."""

    def __init__(self, topics: Mapping[str, Series]) -> None:
        self._joints: dict[str, tuple[str, Floats]] = {
            child: (parent, matrix)
            for series in topics.values()
            for transforms in series.values
            for parent, child, matrix in transforms
        }

    def mount(self, frame: str) -> SensorMount:
        """Return the root of a frame's tree, and the frame's pose in it."""
        pose = np.eye(4)
        for _ in self._joints:  # a loop in a broken tree ends too
            if frame not in self._joints:
                break
            frame, joint = self._joints[frame]
            pose = joint @ pose
        block = pose[:2, :2]
        determinant = float(np.linalg.det(block))
        if abs(determinant) < _TILTED:
            return SensorMount(frame, None)
        shift, turn = (
            np.array(complex(*column), dtype=np.complex128) for column in (pose[:2, 3], block[:, 0])
        )
        return SensorMount(frame, Planar(shift, turn, flipped=determinant < 0.0))


class Motion:
    """Poses of the robot's frames in the odometry frame, from ``nav_msgs/msg/Odometry``."""

    def __init__(self, series: Series, frames: Frames) -> None:
        stamps, children, *pose = zip(*series.values, strict=True)
        order = np.argsort(stamps, kind="stable")
        x, y, yaw = (np.array(column)[order] for column in pose)
        self._stamps_s = np.array(stamps)[order]
        self._columns = x, y, np.unwrap(yaw)
        self._base = frames.mount(children[0])

    def base(self, stamps_s: Floats) -> Planar:
        """Return the poses of odometry's child frame, one for each stamp."""
        x, y, yaw = (np.interp(stamps_s, self._stamps_s, column) for column in self._columns)
        return Planar(x + 1j * y, np.exp(1j * yaw))

    def at(self, mount: SensorMount, stamps_s: Floats) -> Planar:
        """Return the poses of a sensor, one for each stamp."""
        base = self.base(stamps_s)
        if self._base.root == mount.root and self._base.pose is not None:
            base = base.compose(self._base.pose.inverse())
        return base if mount.pose is None else base.compose(mount.pose)


@dataclass(frozen=True, slots=True)
class ScannerSetup:
    """The scanners of a robot, their mounts, and the robot's motion."""

    scanners: Mapping[str, RecordedScans]  # by topic
    mounts: Mapping[
        str, SensorMount
    ]  # by topic; scanners that are tilted or turn no ray are left out
    frames: Frames
    motion: Motion | None

    def placed(self, mount: SensorMount, stamps_s: Floats) -> Planar:
        """Return the poses of a sensor in the odometry frame, or on the robot without odometry."""
        if self.motion is not None:
            return self.motion.at(mount, stamps_s)
        count = len(stamps_s)
        on_robot = Planar(np.zeros(count, np.complex128), np.ones(count, np.complex128))
        return on_robot if mount.pose is None else on_robot.compose(mount.pose)


def scanner_setup(window: Window) -> ScannerSetup:
    """Return the setup from the messages on `SETUP_TOPICS`, computed once for all plugins."""
    used = {name: window.topics[name] for name in SETUP_TOPICS}
    key = tuple((n, t, id(series.values)) for n, of in used.items() for t, series in of.items())
    if key not in window.shared:
        window.shared[key] = _setup(used), used  # what is kept keeps its identity
    setup: ScannerSetup = window.shared[key][0]
    return setup


def _setup(topics: Mapping[str, Mapping[str, Series]]) -> ScannerSetup:
    frames = Frames(topics["frames"])
    used = sorted(topics["scans"].items())[:_MOST_SCANNERS]
    scanners = {topic: RecordedScans(series) for topic, series in used}
    mounts = {topic: frames.mount(scans.frame) for topic, scans in scanners.items()}
    moved = the_topic(topics["odometry"])
    return ScannerSetup(
        scanners,
        {
            topic: mount
            for topic, mount in mounts.items()
            if mount.pose is not None and np.all(scanners[topic].angle_increment != 0.0)
        },
        frames,
        None if moved is None else Motion(moved, frames),
    )


def the_topic(topics: Mapping[str, Series]) -> Series | None:
    """Return the messages of a role that a robot has one topic of; None if it has none."""
    return next(iter(topics.values()), None)


def keep_odometry(messages: Any) -> tuple[Any, ...]:
    """Return the values for `Motion` from ``nav_msgs/msg/Odometry``."""
    frames = frame_names(messages.child_frame_id)
    return header_stamps_s(messages), frames, *poses_of(messages.pose.pose)


def keep_frames(message: Any) -> list[tuple[str, str, Floats]]:
    """Return parent, child and pose, as a 4 by 4 matrix, of each transform of a tf message."""
    return [
        (each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/"), _matrix(each.transform))
        for each in message.transforms
    ]


def _matrix(transform: Any) -> Floats:
    shift, q = transform.translation, transform.rotation
    length = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if length == 0.0:
        raise ValueError("a transform has no rotation")
    x, y, z, w = q.x / length, q.y / length, q.z / length, q.w / length
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    return np.array([
        [xx - yy - zz + ww, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w), shift.x],
        [2.0 * (x * y + z * w), -xx + yy - zz + ww, 2.0 * (y * z - x * w), shift.y],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -xx - yy + zz + ww, shift.z],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


SETUP_TOPICS = {
    "scans": SCANS,
    "odometry": Request(keep_odometry, role=ODOMETRY, dtype=object, optional=True, many=True),
    "frames": Request(keep_frames, role=STATIC_TRANSFORMS, dtype=object, optional=True),
}


def nearest(times_s: Floats, wanted_s: Floats) -> Ints:
    """Return the index of the time nearest to each wanted one; times ascend."""
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(1, len(times_s) - 1))
    before = after - 1
    if len(times_s) == 1:
        return np.zeros(len(wanted_s), dtype=np.int64)
    closer = wanted_s - times_s[before] <= times_s[after] - wanted_s
    return np.where(closer, before, after)
