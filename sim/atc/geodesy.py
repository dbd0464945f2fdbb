"""Positions around the airport: on WGS 84, in the plane tangent to it there, and as radar ranges.

Great-circle maths comes from GeographicLib. What runs for every message is inlined here: the
plane is the ellipsoid's orthographic projection (EPSG method 9840), whose two directions are
closed formulas; 80 km from the airport it is 2 m short. x points east, y north, both in metres at
the height of the ellipsoid.
"""

import math
from typing import NamedTuple

from geographiclib.geodesic import Geodesic

from oracle_pipeline.bags.jit import jit


class Place(NamedTuple):
    """A point on WGS 84 [deg]."""

    latitude: float
    longitude: float


AIRPORT = Place(44.2253, -76.5967)  # Kingston, Ontario (CYGK)
ELEVATION_M = 93.0  # of its runway

_A = float(Geodesic.WGS84.a)
_F = float(Geodesic.WGS84.f)
_E2 = _F * (2.0 - _F)
_B = _A * (1.0 - _F)

_SIN_LAT = math.sin(math.radians(AIRPORT.latitude))
_COS_LAT = math.cos(math.radians(AIRPORT.latitude))
_LON = math.radians(AIRPORT.longitude)
_NU = _A / math.sqrt(1.0 - _E2 * _SIN_LAT**2)  # radius of curvature across the meridian
_RADIUS = _NU * math.sqrt((1.0 - _E2) / (1.0 - _E2 * _SIN_LAT**2))  # Gauss's mean radius


def destination(start: Place, azimuth_deg: float, distance_m: float) -> Place:
    """Return the end point of a geodesic of given start, azimuth and length."""
    there = Geodesic.WGS84.Direct(*start, azimuth_deg, distance_m)
    return Place(there["lat2"], there["lon2"])


def distance(start: Place, end: Place) -> float:
    """Return the length of the geodesic between two points [m]."""
    return float(Geodesic.WGS84.Inverse(*start, *end)["s12"])


def between(start: Place, end: Place, share: float) -> Place:
    """Return the point after a share of the geodesic from start to end."""
    line = Geodesic.WGS84.InverseLine(*start, *end)
    there = line.Position(share * line.s13)
    return Place(there["lat2"], there["lon2"])


@jit
def to_plane(latitude: float, longitude: float) -> tuple[float, float]:
    """Return x and y [m] of a place [deg] on the ellipsoid."""
    latitude, longitude = math.radians(latitude), math.radians(longitude) - _LON
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    nu = _A / math.sqrt(1.0 - _E2 * sin_lat**2)
    x = nu * cos_lat * math.sin(longitude)
    y = nu * (sin_lat * _COS_LAT - cos_lat * _SIN_LAT * math.cos(longitude))
    return x, y + _E2 * (_NU * _SIN_LAT - nu * sin_lat) * _COS_LAT


@jit
def to_geodetic(x: float, y: float) -> tuple[float, float]:
    """Return latitude and longitude [deg] of the point of the ellipsoid below x, y [m].

    With the airport's meridian for the first axis, the point is ``q + u * up`` with ``q`` in the
    plane; squeezed along its axes, the ellipsoid is a sphere, which makes ``u`` the root of a
    quadratic.
    """
    qx = _NU * _COS_LAT - y * _SIN_LAT
    qz = _NU * (1.0 - _E2) * _SIN_LAT + y * _COS_LAT
    a = (_COS_LAT / _A) ** 2 + (_SIN_LAT / _B) ** 2
    b = _COS_LAT * qx / _A**2 + _SIN_LAT * qz / _B**2
    c = (qx**2 + x**2) / _A**2 + (qz / _B) ** 2 - 1.0
    u = -c / (b + math.sqrt(b**2 - a * c))
    px, pz = qx + u * _COS_LAT, qz + u * _SIN_LAT
    latitude = math.atan2(pz, (1.0 - _E2) * math.hypot(px, x))
    return math.degrees(latitude), math.degrees(_LON + math.atan2(x, px))


@jit
def convergence(latitude: float, longitude: float) -> float:
    """Return the angle from true north, at a place [deg], to the plane's y axis [rad].

    Added to a bearing in the plane it gives the true bearing.
    """
    return (math.radians(longitude) - _LON) * math.sin(math.radians(latitude))


@jit
def slant_range(ground_m: float, altitude_m: float) -> float:
    """Return the distance from the radar at the airport to an aircraft [m].

    Parameters
    ----------
    ground_m
        Distance from the origin of the plane to the point below the aircraft.
    altitude_m
        Of the aircraft above the ellipsoid.
    """
    radar, aircraft = _RADIUS + ELEVATION_M, _RADIUS + altitude_m
    cosine = math.sqrt(1.0 - (ground_m / _RADIUS) ** 2)
    return math.sqrt((aircraft - radar) ** 2 + 2.0 * radar * aircraft * (1.0 - cosine))


@jit
def ground_range(slant_m: float, altitude_m: float) -> float:
    """Return the inverse of `slant_range`; 0 for an aircraft right above the radar."""
    radar, aircraft = _RADIUS + ELEVATION_M, _RADIUS + altitude_m
    versine = max(slant_m**2 - (aircraft - radar) ** 2, 0.0) / (2.0 * radar * aircraft)
    return _RADIUS * math.sqrt(versine * (2.0 - versine))
