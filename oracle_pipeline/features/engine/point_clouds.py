"""Converts point clouds to the scans of a planar scanner at the same position.

A cloud is cut at the height of its sensor, in the sensor's own frame (x forward, y left, z up). Of
the points near that plane, the nearest in each direction is a return. A direction without a point
is unknown rather than free, since drivers and filters leave points out.
"""

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.features.engine.columns import ColumnSource

RAYS: Final = 360
_HEIGHT_M: Final = 0.05  # from the plane, or, further away:
# Over the distance; sensors have a layer each 2 deg.
_ELEVATION: Final = math.tan(math.radians(1.5))
NEAREST_M, FARTHEST_M = 0.05, 200.0  # limits of returns

_FLOATS = {7: "f4", 8: "f8"}  # by sensor_msgs/msg/PointField


class _PlanarScan(NamedTuple):
    """The fields of a ``sensor_msgs/msg/LaserScan`` with ranges; or of many, as columns."""

    header: Any
    ranges: NDArray[Any]  # shape (RAYS,) [m]; NaN: nothing is known
    angle_min: Any = -math.pi
    angle_max: Any = math.pi - 2.0 * math.pi / RAYS
    angle_increment: Any = 2.0 * math.pi / RAYS
    range_min: Any = NEAREST_M
    range_max: Any = FARTHEST_M


class CutClouds:
    """Point clouds converted to scans; implements `ColumnSource`."""

    def __init__(self, clouds: ColumnSource, decode: Callable[[bytes], Any]) -> None:
        self.data = clouds.data
        self._clouds = clouds
        self._decode = decode

    @cached_property
    def _columns(self) -> _PlanarScan:
        scans = [sliced(self._decode(each)) for each in self.data]
        ranges = np.empty(len(scans), dtype=object)
        ranges[:] = [scan.ranges for scan in scans]
        numbers = (np.full(len(scans), number) for number in scans[0][2:])
        return _PlanarScan(self._clouds.columns().header, ranges, *numbers)

    def columns(self) -> _PlanarScan:
        """Return the scans as columns."""
        return self._columns

    def some(self, rows: NDArray[np.int64]) -> "CutClouds":
        """Return some of the clouds."""
        return CutClouds(self._clouds.some(rows), self._decode)


def sliced(cloud: Any) -> _PlanarScan:
    """Return the scan of a ``sensor_msgs/msg/PointCloud2``.

    Raises
    ------
    BagError
        It has no coordinates x, y and z, or fewer bytes than points.
    """
    x, y, z = _coordinates(cloud)
    distance = np.hypot(x, y)
    near = np.abs(z) <= np.maximum(_HEIGHT_M, _ELEVATION * distance)
    near &= (distance >= NEAREST_M) & (distance <= FARTHEST_M)
    ray = np.round((np.arctan2(y[near], x[near]) + math.pi) * (RAYS / (2.0 * math.pi)))
    ranges = np.full(RAYS, np.inf)
    np.minimum.at(ranges, ray.astype(np.int64) % RAYS, distance[near])
    ranges[np.isinf(ranges)] = np.nan
    return _PlanarScan(cloud.header, ranges.astype(np.float32))


def _coordinates(cloud: Any) -> list[NDArray[np.float64]]:
    """Return x, y and z of all points [m], shape (n,) each."""
    fields = {field.name: field for field in cloud.fields}
    if not {"x", "y", "z"} <= fields.keys():
        raise BagError("is a point cloud without x, y and z")
    order, step = ">" if cloud.is_bigendian else "<", int(cloud.point_step)
    formats = [order + _FLOATS.get(fields[name].datatype, "V0") for name in "xyz"]
    offsets = [int(fields[name].offset) for name in "xyz"]
    try:
        point = np.dtype(
            {"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step}
        )
    except ValueError as error:
        raise BagError(f"is a point cloud whose points are not laid out: {error}") from error
    if "V" in "".join(formats):
        raise BagError("is a point cloud whose x, y and z are not floating-point numbers")
    data = np.ascontiguousarray(cloud.data, dtype=np.uint8)
    width, height = int(cloud.width) * step, int(cloud.height)
    row = width if height == 1 else int(cloud.row_step)
    if row < width or len(data) < height * row:
        raise BagError(f"is a point cloud of {height} rows of {row} bytes in {len(data)} bytes")
    if not width or not height:
        return [np.zeros(0)] * 3
    points = np.ascontiguousarray(data[: height * row].reshape(height, row)[:, :width])
    packed = points.reshape(-1).view(point)
    return [packed[name].astype(np.float64) for name in "xyz"]
