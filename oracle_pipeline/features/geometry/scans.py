"""Laser scans: the values kept of their messages, and their arrays.

A range is NaN where nothing is known and ``inf`` where the ray met nothing (REP 117). A recording
may be all scans, so it is never laid out whole: `in_blocks` takes some scans after the others.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s
from oracle_pipeline.features.engine.plugin import Request, Series
from oracle_pipeline.robots.roles import SCAN

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
Points: TypeAlias = NDArray[np.complex128]  # x + iy [m]

_BLOCK_RAYS: Final = 2**16  # rays per batch, which fits into the processor's cache
_FINEST_RAD: Final = 1e-6  # from ray to ray: 6 million around


@dataclass(frozen=True, slots=True)
class Scans:
    """Some scans of one topic, all with as many rays as the longest has.

    Attributes
    ----------
    times_s, stamps_s : ndarray of shape (n,)
        When recorded, since the start of the recording, and when valid, by the header [s].
    frame : str
        Of the sensor.
    angle_min, angle_increment : ndarray of shape (n, 1)
        Bearing of the first ray, and from one to the next [rad].
    range_max : float
        Up to which the sensor sees [m].
    ranges : ndarray of shape (n, m)
        [m]
    """

    times_s: Floats
    stamps_s: Floats
    frame: str
    angle_min: Floats
    angle_increment: Floats
    range_max: float
    ranges: Floats

    @property
    def rays(self) -> int:
        """Number of rays of a scan."""
        return int(self.ranges.shape[1])

    def rows(self, index: Ints | slice) -> "Scans":
        """Return some of the scans."""
        return Scans(
            self.times_s[index], self.stamps_s[index], self.frame, self.angle_min[index],
            self.angle_increment[index], self.range_max, self.ranges[index],
        )  # fmt: skip

    def bearings(self) -> Floats:
        """Return the bearing of each ray in the sensor's frame [rad], shape (n, m).

        It has one row, shape (1, m), if all scans have the same.
        """
        start, step = self.angle_min, self.angle_increment
        if len(start) and (start == start[0]).all() and (step == step[0]).all():
            start, step = start[:1], step[:1]
        return start + step * np.arange(self.rays)

    def rays_along(self) -> Points:
        """Return the unit vector along each ray, of as many rows as `bearings`."""
        along: Points = np.exp(1j * self.bearings())
        return along

    def points(self) -> Points:
        """Return the ends of rays in the sensor's frame, shape (n, m); NaN without a return."""
        finite = np.where(np.isfinite(self.ranges), self.ranges, np.nan)
        return finite * self.rays_along()


class RecordedScans:
    """The scans of one topic as kept: `Scans` without ranges; `rows` returns them with ranges.

    Attributes
    ----------
    rays : int
        Of the longest scan.
    """

    def __init__(self, series: Series) -> None:
        stamps, frames, starts, steps, limits, ranges = zip(*series.values, strict=True)
        self.times_s, self.stamps_s = series.times_s, np.array(stamps)
        self.frame: str = frames[0]
        self.angle_min = np.array(starts)[:, np.newaxis]
        self.angle_increment = np.array(steps)[:, np.newaxis]
        self.range_max = float(max(limits))
        self.rays = max(map(len, ranges))
        self._is_even = self.rays == min(map(len, ranges))
        self._ranges = np.empty(len(ranges), dtype=object)
        self._ranges[:] = ranges

    def have_bearings(self) -> bool:
        """Return whether each ray of each scan has a bearing, and a number around the circle."""
        steps = np.abs(self.angle_increment)
        return bool(np.all((steps >= _FINEST_RAD) & (steps <= np.pi) & np.isfinite(self.angle_min)))

    def rows(self, index: Ints | slice) -> Scans:
        """Return some of the scans, with their ranges as one array."""
        return Scans(
            self.times_s[index], self.stamps_s[index], self.frame, self.angle_min[index],
            self.angle_increment[index], self.range_max, self._laid_out(self._ranges[index]),
        )  # fmt: skip

    def _laid_out(self, ranges: NDArray[np.object_]) -> Floats:
        if self._is_even and len(ranges):
            joined = np.concatenate(ranges.tolist(), dtype=np.float64)
            return joined.reshape(len(ranges), self.rays)
        laid_out = np.full((len(ranges), self.rays), np.nan)
        for row, measured in zip(laid_out, ranges, strict=True):
            row[: len(measured)] = measured
        return laid_out


def in_blocks(
    count: int, rays: int, work: Callable[[slice], tuple[NDArray[Any], ...]]
) -> list[NDArray[Any]]:
    """Call a function on a few scans at a time, and join its results.

    Parameters
    ----------
    count, rays : int
        Scans in all, and rays of each.
    work : callable
        Returns arrays for some of the scans; it is called once at least.
    """
    step = max(1, _BLOCK_RAYS // max(1, rays))
    blocks = [work(slice(first, first + step)) for first in range(0, max(1, count), step)]
    return [np.concatenate(column) for column in zip(*blocks, strict=True)]


def _keep_scans(messages: Any) -> tuple[Any, ...]:
    """Return the values for `RecordedScans` from ``sensor_msgs/msg/LaserScan``s."""
    return (
        header_stamps_s(messages), frame_names(messages.header.frame_id), messages.angle_min,
        messages.angle_increment, messages.range_max, _valid(messages),
    )  # fmt: skip


def _valid(messages: Any) -> NDArray[np.object_]:
    """Return the ranges of each scan, NaN below its limits and ``inf`` beyond them.

    They are a copy, as messages have more than ranges.
    """
    counts = np.array([ranges.size for ranges in messages.ranges])
    joined = np.concatenate(messages.ranges.tolist())
    joined[joined < np.repeat(messages.range_min, counts)] = np.nan
    joined[joined > np.repeat(messages.range_max, counts)] = np.inf
    split = np.empty(len(counts), dtype=object)
    split[:] = np.split(joined, np.cumsum(counts)[:-1])
    return split


SCANS = Request(_keep_scans, role=SCAN, dtype=object, many=True)
