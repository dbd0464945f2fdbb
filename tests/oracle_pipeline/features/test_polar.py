import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from oracle_pipeline.features.geometry.polar import distances, rays

COORDINATE = st.one_of(
    st.floats(-50.0, 50.0), st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-9, -1e-9, 1e-160])
)
POINTS = st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=20)


def columns(points):
    return (np.array(column) for column in zip(*points, strict=True))


@given(POINTS)
@example([(0.0, 0.0), (math.nan, 1.0)])
def test_distances_are_those_of_the_c_library(points):
    x, y = columns(points)
    found = np.empty(len(x))
    distances(x, y, found)
    long = ~(np.hypot(x, y) < 1e-150)  # squares of shorter ones are zero
    np.testing.assert_array_max_ulp(found[long], np.hypot(x, y)[long], maxulp=1)


@given(
    POINTS,
    st.floats(-3.2, 3.2),
    st.one_of(st.sampled_from([math.radians(1.0), -math.radians(0.25)]), st.floats(1e-7, 0.2)),
)
@example([(-1.0, -0.0), (-1.0, 0.0), (0.0, 0.0)], 0.0, math.radians(1.0))
@example([(math.cos(0.5), math.sin(0.5))], 0.0, 1.0)
def test_a_point_is_nearest_to_the_ray_of_its_bearing(points, start, increment):
    x, y = columns(points)
    found = np.empty(len(x), np.int64)
    rays(x, y, start, increment, found)
    expected = [
        round((math.atan2(b, a) - start) / increment)
        for a, b in zip(x.tolist(), y.tolist(), strict=True)
    ]
    assert found.tolist() == expected


def test_a_point_half_way_between_two_rays_goes_where_rounding_takes_it():
    bearings = np.radians(np.arange(0.5, 179.0))
    found = np.empty(len(bearings), np.int64)
    rays(np.cos(bearings), np.sin(bearings), 0.0, math.radians(1.0), found)
    exact = np.array([math.atan2(math.sin(b), math.cos(b)) for b in bearings.tolist()])
    assert found.tolist() == np.round(exact / math.radians(1.0)).astype(int).tolist()
    assert set(np.diff(found).tolist()) <= {0, 1, 2}


@pytest.mark.parametrize("increment", [1e-12, 5e-10])
def test_bearings_too_fine_for_the_polynomial_are_computed_exactly(increment):
    found = np.empty(1, np.int64)
    rays(np.array([3.0]), np.array([1.0]), 0.0, increment, found)
    assert found[0] == round(math.atan2(1.0, 3.0) / increment)
