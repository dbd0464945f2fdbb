"""The built-in functions, each against another way to the same answer."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.path import Path
from scipy.spatial.transform import Rotation

from oracle_pipeline.bags.types import message_class
from sim.fuzzing.functions import (
    BUILTINS,
    EARTH_RADIUS_M,
    bearing_deg,
    haversine_m,
    in_polygon,
    nearest,
    offset_lat,
    offset_lon,
    ray_circle,
    ray_segment,
)
from sim.fuzzing.value_types import Number
from sim.middleware.geometry import yaw_quaternion

bearings = st.floats(-10.0, 10.0)
metres = st.floats(-20.0, 20.0)
latitudes = st.floats(-85.0, 85.0)
longitudes = st.floats(-180.0, 180.0)
courses = st.floats(-360.0, 720.0)
distances = st.floats(1.0, 5_000_000.0)
anything = st.floats(width=64) | st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan])


@given(bearings, metres, metres, st.floats(0.01, 5.0))
def test_a_ray_ends_on_the_circle_where_the_quadratic_has_its_first_positive_root(
    bearing, x, y, radius
):
    # |t d - c|^2 = r^2 for the unit vector d
    half_b = x * math.cos(bearing) + y * math.sin(bearing)
    c = x * x + y * y - radius * radius
    discriminant = half_b * half_b - c
    assume(abs(discriminant) > 1e-9)
    assume(abs(c) > 1e-9)
    hits = discriminant > 0.0 and half_b > 0.0 and c > 0.0
    with np.errstate(invalid="ignore"):
        found = ray_circle(bearing, x, y, radius)
    assert np.isfinite(found) == hits
    if hits:
        assert found == pytest.approx(half_b - math.sqrt(discriminant), abs=1e-6)


@given(st.floats(0.3, 5.0), bearings, st.floats(0.05, 0.25))
def test_a_ray_meets_a_circle_head_on_at_distance_less_radius(distance, bearing, radius):
    x, y = distance * math.cos(bearing), distance * math.sin(bearing)
    with np.errstate(invalid="ignore"):
        ahead, behind = ray_circle(np.array([bearing, bearing + math.pi]), x, y, radius)
    assert ahead == pytest.approx(distance - radius, abs=1e-9)
    assert behind == math.inf


@given(bearings, st.floats(0.0, 0.99), bearings, st.floats(0.01, 5.0))
def test_a_ray_that_starts_inside_a_circle_does_not_see_it(bearing, share, direction, radius):
    away = share * radius
    x, y = away * math.cos(direction), away * math.sin(direction)
    assert ray_circle(bearing, x, y, radius) == math.inf


@given(bearings, metres, metres, metres, metres)
def test_a_ray_ends_on_the_wall_that_it_meets(bearing, x1, y1, x2, y2):
    with np.errstate(all="ignore"):
        distance = ray_segment(bearing, x1, y1, x2, y2)
    assume(np.isfinite(distance))
    x, y = distance * math.cos(bearing), distance * math.sin(bearing)
    detour = math.hypot(x - x1, y - y1) + math.hypot(x - x2, y - y2)
    assert distance >= 0.0
    assert detour == pytest.approx(math.hypot(x1 - x2, y1 - y2), abs=1e-5)


@given(bearings, st.floats(0.1, 20.0), st.floats(0.05, 1.5), st.floats(0.05, 1.5))
def test_a_ray_meets_every_wall_across_it_and_none_behind(bearing, distance, left, right):
    def corner(turn, away):
        return away * math.cos(bearing + turn), away * math.sin(bearing + turn)

    wall = (*corner(left, distance / math.cos(left)), *corner(-right, distance / math.cos(right)))
    assert ray_segment(bearing, *wall) == pytest.approx(distance, rel=1e-6)
    assert ray_segment(bearing + math.pi, *wall) == math.inf


def test_a_ray_along_a_wall_does_not_see_it():
    with np.errstate(invalid="ignore", divide="ignore"):
        assert ray_segment(0.0, 1.0, 0.0, 2.0, 0.0) == math.inf


@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=9, unique=True)
)
def test_in_polygon_agrees_with_matplotlib_off_the_border(corners):
    # Even and odd lie otherwise where a polygon covers itself twice, so this one is a star.
    centre = np.mean(corners, axis=0)
    turns = np.arctan2(*(np.array(corners) - centre).T)
    assume(len({round(turn, 6) for turn in turns}) == len(corners))
    star = np.array(corners)[np.argsort(turns)]
    x, y = (
        axis.ravel() + 0.3141
        for axis in np.mgrid[-9:9, -9:9] + np.array([0, 0.1234])[:, None, None]
    )
    path = Path(star)
    clear = path.contains_points(np.c_[x, y], radius=1e-6) == path.contains_points(
        np.c_[x, y], radius=-1e-6
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        np.testing.assert_array_equal(
            in_polygon(x, y, star)[clear], path.contains_points(np.c_[x, y])[clear]
        )


def on_sphere(latitude, longitude):
    """The unit vector of a position."""
    north, east = math.radians(latitude), math.radians(longitude)
    return np.array(
        [math.cos(north) * math.cos(east), math.cos(north) * math.sin(east), math.sin(north)]
    )


@given(latitudes, longitudes, latitudes, longitudes)
def test_haversine_is_the_angle_between_the_vectors_of_two_positions(lat, lon, to_lat, to_lon):
    here, there = on_sphere(lat, lon), on_sphere(to_lat, to_lon)
    angle = math.atan2(np.linalg.norm(np.cross(here, there)), here @ there)
    assert haversine_m(lat, lon, to_lat, to_lon) == pytest.approx(
        EARTH_RADIUS_M * angle, rel=1e-7, abs=1e-3
    )


@given(latitudes, longitudes, courses, distances)
def test_an_offset_is_the_rotation_about_the_axis_of_its_great_circle(lat, lon, course, distance):
    east = np.array([-math.sin(math.radians(lon)), math.cos(math.radians(lon)), 0.0])
    here = on_sphere(lat, lon)
    north = np.cross(here, east)
    towards = north * math.cos(math.radians(course)) + east * math.sin(math.radians(course))
    axis = np.cross(here, towards)
    there = Rotation.from_rotvec(axis * distance / EARTH_RADIUS_M).apply(here)
    found = on_sphere(offset_lat(lat, course, distance), offset_lon(lat, lon, course, distance))
    np.testing.assert_allclose(found, there, atol=1e-9)


@given(latitudes, longitudes, courses, st.floats(10.0, 1_000_000.0))
def test_an_offset_has_the_given_distance_and_course(lat, lon, course, distance):
    to_lat, to_lon = offset_lat(lat, course, distance), offset_lon(lat, lon, course, distance)
    assert haversine_m(lat, lon, to_lat, to_lon) == pytest.approx(distance, rel=1e-6, abs=1e-2)
    turn = bearing_deg(lat, lon, to_lat, to_lon) - course
    assert (turn + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-3)


# geographiclib 2.1, Geodesic.WGS84.Direct(lat, lon, course, distance): ["lat2"], ["lon2"]
WGS84 = [
    ((44.2253, -76.5967), 90.0, 5000.0, (44.22528286, -76.53412340)),
    ((44.25, -76.55), 180.0, 3000.0, (44.22300140, -76.55000000)),
    ((0.0, 0.0), 45.0, 100000.0, (0.63947233, 0.63523103)),
    ((0.0, 179.9), 90.0, 50000.0, (0.00000000, -179.65084236)),
    ((-33.9, 151.2), 225.0, 250000.0, (-35.47820245, 149.25225470)),
    ((70.0, 25.0), 350.0, 20000.0, (70.17652373, 24.90827654)),
    ((51.5, -0.1), 288.0, 5000000.0, (43.65876423, -68.08576922)),
    ((0.0, 10.0), 0.0, 1000.0, (0.00904369, 10.00000000)),
]


@pytest.mark.parametrize(("start", "course", "distance", "end"), WGS84)
def test_the_sphere_is_within_the_promised_share_of_the_ellipsoid(start, course, distance, end):
    found = offset_lat(start[0], course, distance), offset_lon(*start, course, distance)
    assert haversine_m(*found, *end) < 0.006 * distance
    assert haversine_m(*start, *end) == pytest.approx(distance, rel=0.006)


@given(longitudes, courses, distances)
def test_offsets_stay_on_the_globe(lon, course, distance):
    for lat in (-90.0, 0.0, 90.0):
        assert -90.0 <= offset_lat(lat, course, distance) <= 90.0
        assert -180.0 <= offset_lon(lat, lon, course, distance) < 180.0


@given(latitudes, longitudes, latitudes, longitudes)
def test_a_bearing_is_from_0_to_below_360(lat, lon, to_lat, to_lon):
    assert 0.0 <= bearing_deg(lat, lon, to_lat, to_lon) < 360.0


rows = st.fixed_dictionaries({"lat": latitudes | st.just(math.nan), "lon": longitudes})
tables = st.dictionaries(st.sampled_from(["A1", "B2", "C3", "D4"]), rows)


@given(tables, latitudes, longitudes, st.sampled_from(["A1", "B2\0\0 ", "none"]))
def test_nearest_is_the_row_that_no_other_is_nearer_than(table, lat, lon, exclude):
    found = nearest(table, lat, lon, exclude)
    others = {key: row for key, row in table.items() if key != exclude.rstrip("\0 ")}
    away = {key: haversine_m(lat, lon, row["lat"], row["lon"]) for key, row in others.items()}
    away = {key: distance for key, distance in away.items() if not math.isnan(distance)}
    if not away:
        assert found is None
    else:
        assert found is table[min(sorted(away), key=away.__getitem__)]


@given(tables, latitudes, longitudes)
def test_nearest_does_not_depend_on_the_order_of_rows(table, lat, lon):
    backwards = dict(reversed(table.items()))
    assert nearest(table, lat, lon, "") is nearest(backwards, lat, lon, "")


@given(st.floats(-3.1, 3.1))
def test_quat_yaw_undoes_a_rotation_about_z(yaw):
    quaternion = message_class("geometry_msgs/msg/Quaternion")(*yaw_quaternion(yaw))
    assert BUILTINS["quat_yaw"].evaluate(quaternion) == pytest.approx(yaw)


def of_numbers():
    """The built-ins that take numbers only and do not draw, with how many."""
    for name, builtin in BUILTINS.items():
        count = next((n for n in range(1, 6) if builtin.result([Number("float64")] * n)), 0)
        if count and not builtin.draws:
            yield pytest.param(builtin.evaluate, count, id=name)


@pytest.mark.parametrize(("function", "count"), list(of_numbers()))
@given(data=st.data())
def test_a_function_of_arrays_is_the_function_of_each_element(function, count, data):
    columns = st.lists(anything, min_size=7, max_size=7).map(np.array)
    arguments = [data.draw(columns) for _ in range(count)]
    with np.errstate(all="ignore"):
        together = function(*arguments)
        one_by_one = [function(*values) for values in zip(*arguments, strict=True)]
    np.testing.assert_array_equal(together, one_by_one)


@given(anything, st.sampled_from(["uniform", "gauss", "bernoulli"]), st.data())
def test_a_random_function_draws_one_value_an_element(first, name, data):
    draw = BUILTINS[name].evaluate
    arguments = [first] if name == "bernoulli" else [first, data.draw(anything)]
    with np.errstate(all="ignore"):
        assert draw(np.random.default_rng(1), 5, *arguments).shape == (5,)
        assert np.ndim(draw(np.random.default_rng(1), None, *arguments)) == 0


@given(st.floats(-100.0, 100.0), st.floats(0.0, 100.0))
def test_uniform_stays_between_its_bounds_and_gauss_scales_a_standard_draw(low, width):
    drawn = BUILTINS["uniform"].evaluate(np.random.default_rng(3), 50, low, low + width)
    assert (drawn >= low).all()
    assert (drawn <= low + width).all()
    drawn = BUILTINS["gauss"].evaluate(np.random.default_rng(3), 50, low, width)
    np.testing.assert_array_equal(drawn, low + width * np.random.default_rng(3).standard_normal(50))


def test_bernoulli_is_never_at_0_and_always_at_1():
    flip = BUILTINS["bernoulli"].evaluate
    assert not flip(np.random.default_rng(5), 100, 0.0).any()
    assert flip(np.random.default_rng(5), 100, 1.0).all()
