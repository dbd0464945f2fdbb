"""Positions on WGS 84 as seen from a place on it: east, north and up, by way of Cartesian axes."""

import cmath
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from geographiclib.geodesic import Geodesic
from numpy.typing import NDArray

_A = float(Geodesic.WGS84.a)  # [m]
_E2 = float(Geodesic.WGS84.f * (2.0 - Geodesic.WGS84.f))


def cartesian(latitude: Any, longitude: Any, altitude_m: Any) -> NDArray[np.float64]:
    """Return earth-centred, earth-fixed coordinates [m], shape (3, ...), of positions [deg]."""
    lat, lon = np.radians(latitude), np.radians(longitude)
    normal = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    across = (normal + altitude_m) * np.cos(lat)
    up = (normal * (1.0 - _E2) + altitude_m) * np.sin(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), up])


@dataclass(frozen=True, slots=True)
class Site:
    """A place on the ellipsoid to look from [deg], or n places, each for a position of its own."""

    latitude: Any
    longitude: Any

    def seen(
        self, positions: NDArray[np.float64]
    ) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """Return north + i east and up [m] of Cartesian positions, shape (3, n).

        The angle of the complex number is the azimuth.
        """
        lat, lon = np.radians(self.latitude), np.radians(self.longitude)
        origin = cartesian(self.latitude, self.longitude, 0.0)
        x, y, z = positions - origin.reshape(3, -1)
        away = np.cos(lon) * x + np.sin(lon) * y  # from the earth's axis
        north, up = np.cos(lat) * z - np.sin(lat) * away, np.cos(lat) * away + np.sin(lat) * z
        return north + 1j * (np.cos(lon) * y - np.sin(lon) * x), up

    def moved(self, step: complex) -> "Site":
        """Return the place north + i east [m] from this one."""
        azimuth = math.degrees(cmath.phase(step))
        end = Geodesic.WGS84.Direct(self.latitude, self.longitude, azimuth, abs(step))
        return Site(end["lat2"], end["lon2"])
