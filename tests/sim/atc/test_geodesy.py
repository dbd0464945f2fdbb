import math

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given
from hypothesis import strategies as st

from sim.atc.geodesy import (
    AIRPORT,
    ELEVATION_M,
    Place,
    between,
    convergence,
    destination,
    distance,
    ground_range,
    slant_range,
    to_geodetic,
    to_plane,
)

azimuths = st.floats(0.0, 360.0)
distances = st.floats(10.0, 110_000.0)
altitudes = st.floats(0.0, 12_000.0)


def ecef(latitude, longitude, height_m):
    """Earth-centred coordinates, from the definition."""
    a, f = Geodesic.WGS84.a, Geodesic.WGS84.f
    e2 = f * (2.0 - f)
    lat, lon = math.radians(latitude), math.radians(longitude)
    nu = a / math.sqrt(1.0 - e2 * math.sin(lat) ** 2)
    return np.array(
        [
            (nu + height_m) * math.cos(lat) * math.cos(lon),
            (nu + height_m) * math.cos(lat) * math.sin(lon),
            (nu * (1.0 - e2) + height_m) * math.sin(lat),
        ]
    )


@given(azimuths, distances)
def test_the_plane_and_the_ellipsoid_are_inverse_to_each_other(azimuth, metres):
    place = destination(AIRPORT, azimuth, metres)
    assert to_geodetic(*to_plane(*place)) == pytest.approx(place, abs=1e-11)


@given(azimuths, distances)
def test_polar_coordinates_in_the_plane_are_azimuth_and_distance_of_the_geodesic(azimuth, metres):
    x, y = to_plane(*destination(AIRPORT, azimuth, metres))
    off_course = math.degrees(math.atan2(x, y)) - azimuth
    assert (off_course + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-5)
    short = metres**3 / (6.0 * 6.37e6**2)  # an arc against its projection
    assert math.hypot(x, y) == pytest.approx(metres - short, abs=0.05)


@given(azimuths, distances)
def test_convergence_turns_bearings_in_the_plane_into_true_bearings(azimuth, metres):
    there = destination(AIRPORT, azimuth, metres)
    geodesic = Geodesic.WGS84.Inverse(*AIRPORT, *there)
    turned = geodesic["azi2"] - geodesic["azi1"]  # a straight line in the plane all the way
    expected = math.degrees(convergence(*there))
    assert (turned - expected + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.01)


@given(azimuths, distances, altitudes)
def test_slant_range_is_the_straight_line_from_the_radar(azimuth, metres, altitude_m):
    place = destination(AIRPORT, azimuth, metres)
    exact = np.linalg.norm(ecef(*place, altitude_m) - ecef(*AIRPORT, ELEVATION_M))
    ground_m = math.hypot(*to_plane(*place))
    assert slant_range(ground_m, altitude_m) == pytest.approx(exact, abs=1.0)
    assert ground_range(slant_range(ground_m, altitude_m), altitude_m) == pytest.approx(
        ground_m, abs=0.1
    )


def test_an_echo_nearer_than_the_aircraft_is_high_is_right_above_the_radar():
    assert ground_range(900.0, 3_000.0) == 0.0


def test_between_shares_out_the_geodesic():
    there = Place(44.9, -76.2)
    middle = between(AIRPORT, there, 0.25)
    assert distance(AIRPORT, middle) == pytest.approx(0.25 * distance(AIRPORT, there), abs=1e-6)
    assert distance(AIRPORT, middle) + distance(middle, there) == pytest.approx(
        distance(AIRPORT, there), abs=1e-6
    )
