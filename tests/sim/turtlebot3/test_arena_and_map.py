import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from sim.turtlebot3.arena import BLOCKS, CYLINDERS, HEXAGON, RING, RING_THICKNESS
from sim.turtlebot3.map import (
    CELLS,
    FREE,
    OCCUPIED,
    ORIGIN_M,
    RESOLUTION_M,
    UNKNOWN,
    WORLD_IN_MAP,
    occupancy_map,
)

# From the meshes and poses of the original world, as the fact sheet lists them.
CORNERS = {
    "body": [(2.9329, 0), (1.4665, 2.54), (-1.4665, 2.54), (-2.9329, 0), (-1.4665, -2.54)],
    "head": [(4.6732, 0), (4.0866, 1.016), (2.9134, 1.016), (2.3268, 0), (2.9134, -1.016)],
    "left_hand": [(2.6066, 2.7), (2.2033, 3.3985), (1.3967, 3.3985), (0.9934, 2.7)],
}


@pytest.mark.parametrize("piece", [RING, BLOCKS[0], BLOCKS[1]], ids=lambda p: p.name)
def test_hexagons_have_the_corners_of_the_original_meshes(piece):
    expected = CORNERS[piece.name]
    np.testing.assert_allclose(piece.corners()[: len(expected)], expected, atol=1e-3)


def test_the_ring_is_as_thick_as_the_original():
    assert pytest.approx(0.3175, abs=1e-4) == RING_THICKNESS


def test_nine_cylinders_are_on_a_grid_of_1_1_m():
    assert [(c.name, c.x, c.y) for c in CYLINDERS[:4]] == [
        ("one_one", -1.1, -1.1),
        ("one_two", -1.1, 0.0),
        ("one_three", -1.1, 1.1),
        ("two_one", 0.0, -1.1),
    ]
    assert {(c.radius, c.height) for c in CYLINDERS} == {(0.15, 0.5)}


def segment_distance(point, a, b):
    a, b = np.array(a), np.array(b)
    share = np.clip(np.dot(point - a, b - a) / np.dot(b - a, b - a), 0.0, 1.0)
    return np.linalg.norm(point - (a + share * (b - a)))


@given(st.floats(-4, 4), st.floats(-4, 4), st.sampled_from([RING, *BLOCKS]))
def test_distance_to_a_hexagon_is_the_distance_to_its_nearest_side(x, y, hexagon):
    point, corners = np.array([x, y]), hexagon.corners()
    nearest = min(
        segment_distance(point, a, b)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    )
    normals = [math.pi / 6 + i * math.pi / 3 for i in range(6)]
    inside = all(
        (x - hexagon.x) * math.cos(n) + (y - hexagon.y) * math.sin(n) <= hexagon.apothem
        for n in normals
    )
    expected = -nearest if inside else nearest
    assert hexagon.signed_distance(point[None])[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((-2.0, -0.5), 0.5578),  # where the robot starts: the ring's slanted side is nearest
        ((0.55, 0.55), math.hypot(0.55, 0.55) - 0.15),  # amid four pillars
        ((0.0, 0.0), -0.15),  # within a pillar
        ((0.0, 2.7), -0.16),  # within the wall
        ((2.5, 0.0), -0.15),  # within the head, near its tip
    ],
)
def test_clearance_of_known_places(point, expected):
    assert HEXAGON.clearance(np.array([point]))[0] == pytest.approx(expected, abs=2e-3)


def test_the_map_has_the_size_and_about_the_cells_of_the_original():
    world = occupancy_map(HEXAGON)
    assert world.data.shape == (CELLS, CELLS) == (384, 384)
    counts = {value: int((world.data == value).sum()) for value in (OCCUPIED, FREE, UNKNOWN)}
    assert counts[OCCUPIED] == pytest.approx(870, rel=0.05)
    assert counts[FREE] == pytest.approx(7903, rel=0.05)
    assert sum(counts.values()) == CELLS**2


def test_occupied_cells_lie_on_surfaces_seen_through_the_bias_of_the_map():
    rows, columns = np.nonzero(occupancy_map(HEXAGON).data == OCCUPIED)
    in_map = ORIGIN_M + RESOLUTION_M * (np.column_stack([columns, rows]) + 0.5)
    distance = np.abs(HEXAGON.clearance(WORLD_IN_MAP.inverse().apply(in_map)))
    assert distance.max() < 0.10
    assert np.median(distance) < 0.03


def test_free_space_is_connected_and_enclosed_by_occupied_cells():
    data = occupancy_map(HEXAGON).data
    _, pieces = ndimage.label(data == FREE)
    assert pieces == 1
    beside = ndimage.binary_dilation(data == FREE) & (data != FREE)
    assert set(data[beside].tolist()) == {OCCUPIED}
