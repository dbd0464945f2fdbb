"""The built-in functions of the scenario language, over numbers and arrays alike.

Planar geometry is in one frame, x forward and y left [m, rad]; great circles are those of a
sphere of the Earth's mean radius, which is within 0.6 % of the ellipsoid.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from types import MappingProxyType
from typing import Any

import numpy as np

from sim.fuzzing import value_types as vt
from sim.middleware.geometry import quaternion_yaw, wrap_angle

EARTH_RADIUS_M = 6_371_008.8  # mean radius of the WGS 84 ellipsoid

Reals = Any  # a float64 or an array of them; the result is of the same kind
Types = Sequence[vt.Type]


@dataclass(frozen=True, slots=True)
class Builtin:
    """One function that expressions may call.

    Parameters
    ----------
    usage
        How it is called.
    result
        From the types of the arguments to that of the value; None refuses them.
    evaluate
        From the arguments to the value; numbers are float64 unless the result is an integer. None
        stands for a missing record.
    elementwise
        Whether numbers may be arrays; else each argument is one value.
    draws
        Whether ``evaluate`` gets a generator and a count (None for one value) before the arguments.
    work
        Number of elements that it computes for one element of its value.
    """

    usage: str
    result: Callable[[Types], vt.Type | None]
    evaluate: Callable[..., Any]
    elementwise: bool = True
    draws: bool = False
    work: Callable[[Types], int] = lambda types: 1  # noqa: ARG005


def promoted(types: Types) -> vt.Number:
    """Return the type of arithmetic with numbers of these types."""
    return vt.INTEGER if all(kind == vt.INTEGER for kind in types) else vt.FLOAT


def haversine_m(
    latitude: Reals, longitude: Reals, to_latitude: Reals, to_longitude: Reals
) -> Reals:
    """Return the great-circle distance [m] between positions [deg]."""
    north, east = np.radians(latitude), np.radians(longitude)
    to_north, to_east = np.radians(to_latitude), np.radians(to_longitude)
    half_chord_squared = (
        np.sin((to_north - north) / 2.0) ** 2
        + np.cos(north) * np.cos(to_north) * np.sin((to_east - east) / 2.0) ** 2
    )
    return 2.0 * EARTH_RADIUS_M * np.arcsin(np.sqrt(np.minimum(half_chord_squared, 1.0)))


def bearing_deg(
    latitude: Reals, longitude: Reals, to_latitude: Reals, to_longitude: Reals
) -> Reals:
    """Return the first course of the great circle, clockwise from true north in [0, 360) [deg]."""
    north, to_north = np.radians(latitude), np.radians(to_latitude)
    turn = np.radians(np.subtract(to_longitude, longitude))
    eastward = np.sin(turn) * np.cos(to_north)
    northward = np.cos(north) * np.sin(to_north) - np.sin(north) * np.cos(to_north) * np.cos(turn)
    # The second remainder turns a value that rounds up to 360 into 0.
    return np.remainder(np.remainder(np.degrees(np.arctan2(eastward, northward)), 360.0), 360.0)


def offset_lat(latitude: Reals, bearing: Reals, distance: Reals) -> Reals:
    """Return the latitude [deg] after ``distance`` [m] on a great circle that starts on a course.

    Parameters
    ----------
    latitude, bearing
        Where it starts, and on which course, clockwise from true north [deg].
    distance
        Along the great circle [m].
    """
    north, course = np.radians(latitude), np.radians(bearing)
    angle = np.divide(distance, EARTH_RADIUS_M)
    sine = np.sin(north) * np.cos(angle) + np.cos(north) * np.sin(angle) * np.cos(course)
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))


def offset_lon(latitude: Reals, longitude: Reals, bearing: Reals, distance: Reals) -> Reals:
    """Return the longitude, in [-180, 180) [deg], that belongs to ``offset_lat``."""
    north, course = np.radians(latitude), np.radians(bearing)
    angle = np.divide(distance, EARTH_RADIUS_M)
    eastward = np.sin(course) * np.sin(angle)
    northward = np.cos(north) * np.cos(angle) - np.sin(north) * np.sin(angle) * np.cos(course)
    turned = np.add(longitude, np.degrees(np.arctan2(eastward, northward)))
    return np.remainder(turned + 180.0, 360.0) - 180.0


def ray_circle(bearing: Reals, x: Reals, y: Reals, radius: Reals) -> Reals:
    """Return the distance from the origin along a ray to a circle around (x, y).

    Returns
    -------
    float64 or ndarray
        Distance [m]; ``inf`` for a ray that misses, and for all that start inside.
    """
    away, aside = np.hypot(x, y), bearing - np.arctan2(y, x)
    across = away * np.sin(aside)
    half_chord_squared = radius * radius - across * across  # negative where a ray passes by
    distance = away * np.cos(aside) - np.sqrt(np.maximum(half_chord_squared, 0.0))
    return np.where((half_chord_squared >= 0.0) & (distance > 0.0), distance, np.inf)


def ray_segment(bearing: Reals, x1: Reals, y1: Reals, x2: Reals, y2: Reals) -> Reals:
    """Return the distance from the origin along a ray to a wall.

    Returns
    -------
    float64 or ndarray
        Distance [m]; ``inf`` for a ray that misses or runs along the wall.
    """
    ahead, left = np.cos(bearing), np.sin(bearing)
    wide, high = np.subtract(x2, x1), np.subtract(y2, y1)
    across = ahead * high - left * wide
    distance = (x1 * high - y1 * wide) / across
    share = (x1 * left - y1 * ahead) / across
    meets = (across != 0.0) & (distance >= 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.where(meets, distance, np.inf)


def in_polygon(x: Reals, y: Reals, corners: Reals) -> Any:
    """Return whether (x, y) is inside a polygon, by the even-odd rule.

    Parameters
    ----------
    x, y
        Coordinates, in the same plane and units as the corners.
    corners : array_like of shape (n, 2)
        In order; the last is joined to the first.
    """
    polygon = np.asarray(corners, np.float64)
    inside = np.zeros(np.broadcast(x, y).shape, bool)
    for (x1, y1), (x2, y2) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        crosses = (np.greater(y1, y) != np.greater(y2, y)) & np.less(
            x, x1 + (y - y1) * (x2 - x1) / (y2 - y1)
        )
        inside = inside ^ crosses
    return inside


def nearest(
    table: Mapping[str, Mapping[str, Any]], latitude: float, longitude: float, exclude: str
) -> Mapping[str, Any] | None:
    """Return the row nearest to a position [deg], other than that of the key ``exclude``.

    The rows have ``lat`` and ``lon`` [deg]. Of equally distant rows, the one with the first key is
    returned; None if no row has a position.
    """
    keys = sorted(table.keys() - {vt.strip_padding(exclude)})
    positions = np.array([(table[key]["lat"], table[key]["lon"]) for key in keys], np.float64)
    distances = haversine_m(latitude, longitude, *positions.reshape(-1, 2).T)
    if not np.isfinite(distances).any():
        return None
    return table[keys[int(np.nanargmin(distances))]]


def _numbers(count: int, to: vt.Type | None = None) -> Callable[[Types], vt.Type | None]:
    """Accept ``count`` numbers; ``to`` is the result, None the type of their arithmetic."""

    def result(types: Types) -> vt.Type | None:
        if len(types) != count or not _all_numbers(types):
            return None
        return to or promoted(types)

    return result


def _two_or_more_numbers(types: Types) -> vt.Type | None:
    return promoted(types) if len(types) > 1 and _all_numbers(types) else None


def _all_numbers(types: Types) -> bool:
    return all(isinstance(kind, vt.Number) for kind in types)


def _something_long(types: Types) -> vt.Type | None:
    return (
        vt.INTEGER
        if len(types) == 1 and isinstance(types[0], vt.Array | vt.Text | vt.Table)
        else None
    )


def _quaternion(types: Types) -> vt.Type | None:
    return vt.FLOAT if [*types] == [vt.message_type("geometry_msgs/msg/Quaternion")] else None


def _point_and_polygon(types: Types) -> vt.Type | None:
    match types:
        case [vt.Number(), vt.Number(), vt.Array(vt.Array(vt.Number(), 2, True), int())]:
            return vt.BOOLEAN
    return None


def _corners(types: Types) -> int:
    return types[2].bound or 0 if isinstance(types[2], vt.Array) else 0


def _table_position_key(types: Types) -> vt.Type | None:
    match types:
        case [vt.Table() as table, vt.Number(), vt.Number(), vt.Text()] if _all_numbers(
            [table.row.fields.get(name, vt.BOOLEAN) for name in ("lat", "lon")]
        ):
            return table.row
    return None


def _rows(types: Types) -> int:
    return types[0].max_size if isinstance(types[0], vt.Table) else 0


def _length(value: Any) -> np.int64:
    return np.int64(len(vt.strip_padding(value) if isinstance(value, str) else value))


def _draw_uniform(rng: np.random.Generator, n: int | None, low: Reals, high: Reals) -> Reals:
    return low + (high - low) * rng.random(n)


def _draw_normal(rng: np.random.Generator, n: int | None, mean: Reals, sigma: Reals) -> Reals:
    return mean + sigma * rng.standard_normal(n)


def _draw_bernoulli(rng: np.random.Generator, n: int | None, share: Reals) -> Any:
    return rng.random(n) < share


BUILTINS: Mapping[str, Builtin] = MappingProxyType(
    {
        builtin.usage.partition("(")[0]: builtin
        for builtin in (
            Builtin("abs(x)", _numbers(1), np.abs),
            Builtin("min(x, y, ...)", _two_or_more_numbers, lambda *xs: reduce(np.minimum, xs)),
            Builtin("max(x, y, ...)", _two_or_more_numbers, lambda *xs: reduce(np.maximum, xs)),
            Builtin("floor(x)", _numbers(1, vt.FLOAT), np.floor),
            Builtin("sqrt(x)", _numbers(1, vt.FLOAT), np.sqrt),
            Builtin("hypot(x, y)", _numbers(2, vt.FLOAT), np.hypot),
            Builtin("sin(angle)", _numbers(1, vt.FLOAT), np.sin),
            Builtin("cos(angle)", _numbers(1, vt.FLOAT), np.cos),
            Builtin("atan2(y, x)", _numbers(2, vt.FLOAT), np.arctan2),
            Builtin("wrap_angle(angle)", _numbers(1, vt.FLOAT), wrap_angle),
            Builtin("clamp(x, low, high)", _numbers(3), np.clip),
            Builtin("is_finite(x)", _numbers(1, vt.BOOLEAN), np.isfinite),
            Builtin("len(array, text or table)", _something_long, _length, elementwise=False),
            Builtin(
                "quat_yaw(quaternion)",
                _quaternion,
                lambda q: np.float64(quaternion_yaw(q.x, q.y, q.z, q.w)),
                elementwise=False,
            ),
            Builtin("haversine_m(lat, lon, to_lat, to_lon)", _numbers(4, vt.FLOAT), haversine_m),
            Builtin("bearing_deg(lat, lon, to_lat, to_lon)", _numbers(4, vt.FLOAT), bearing_deg),
            Builtin("offset_lat(lat, bearing, distance)", _numbers(3, vt.FLOAT), offset_lat),
            Builtin("offset_lon(lat, lon, bearing, distance)", _numbers(4, vt.FLOAT), offset_lon),
            Builtin("ray_circle(bearing, x, y, radius)", _numbers(4, vt.FLOAT), ray_circle),
            Builtin("ray_segment(bearing, x1, y1, x2, y2)", _numbers(5, vt.FLOAT), ray_segment),
            Builtin(
                "in_polygon(x, y, [[x1, y1], ...])", _point_and_polygon, in_polygon, work=_corners
            ),
            Builtin(
                "nearest(table with lat and lon, lat, lon, exclude key)",
                _table_position_key,
                nearest,
                elementwise=False,
                work=_rows,
            ),
            Builtin("uniform(low, high)", _numbers(2, vt.FLOAT), _draw_uniform, draws=True),
            Builtin("gauss(mean, sigma)", _numbers(2, vt.FLOAT), _draw_normal, draws=True),
            Builtin("bernoulli(share)", _numbers(1, vt.BOOLEAN), _draw_bernoulli, draws=True),
        )
    }
)

CONSTANTS: Mapping[str, bool | float] = MappingProxyType(
    {"true": True, "false": False, "inf": math.inf, "nan": math.nan, "pi": math.pi}
)
