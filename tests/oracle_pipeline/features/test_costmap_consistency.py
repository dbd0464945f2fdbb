import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.lidar import costmap_consistency
from oracle_pipeline.features.lidar.costmap_consistency import unmarked
from oracle_pipeline.features.lidar.map_consistency import MapGrid
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    World,
    driving,
    extract,
    grid_message,
    recording,
)

RESOLUTION = 0.05
CORNER = -2.5 - 2.5j
SCANNER = Scanner("/scan", x_m=0.05, world=World(((0.6, 0.7, 0.2), (-0.8, -0.6, 0.3)), room_m=2.0))


def grid(cells):
    pose = PlanarPose(np.asarray(0j), np.asarray(1.0 + 0j))
    return MapGrid(pose, RESOLUTION, np.asarray(cells, dtype=np.int8))


def marked(lost=lambda place: np.zeros(place.shape, dtype=bool)):
    """Cells of the room and its discs, but for some places."""
    side = np.arange(CORNER.real, -CORNER.real, RESOLUTION) + RESOLUTION / 2
    place = side[np.newaxis, :] + 1j * side[:, np.newaxis]
    solid = np.maximum(np.abs(place.real), np.abs(place.imag)) > 2.0
    for x, y, radius in SCANNER.world.discs:
        solid |= np.abs(place - complex(x, y)) < radius
    return np.where(solid & ~lost(place), 100, 0)


@pytest.fixture
def share(tmp_path):
    def of(cells):
        grids = [
            (
                step / 2 + 0.01,
                "/local_costmap/costmap",
                grid_message(0.0, cells, RESOLUTION, CORNER),
            )
            for step in range(12)
        ]
        recorded = sorted([*recording([SCANNER], driving), *grids], key=lambda each: each[0])
        values, *_ = extract(costmap_consistency.register_features(), recorded, tmp_path)
        return values["unmarked"]

    return of


def test_a_costmap_that_has_what_the_scanner_sees_has_all_of_it(share):
    assert share(marked()) < 0.02


def test_a_costmap_without_obstacles_has_none_of_it(share):
    assert share(np.zeros((100, 100))) == 1.0


def test_a_costmap_that_lost_one_side_lacks_its_share(share):
    assert 0.15 < share(marked(lost=lambda place: place.imag > 1.0)) < 0.6


@given(st.integers(0, 9), st.integers(0, 9), st.integers(-2, 2), st.integers(-2, 2))
def test_a_return_counts_as_marked_within_a_cell_of_a_lethal_one(row, column, down, right):
    cells = np.zeros((10, 10))
    cells[row, column] = 100
    seen = row + down, column + right
    assume(all(0 <= index < 10 for index in seen))
    returns = np.full(5, RESOLUTION * (seen[1] + 0.5 + 1j * (seen[0] + 0.5)))
    assert unmarked(grid(cells), returns) == float(max(abs(down), abs(right)) > 1)


def test_too_few_returns_inside_the_costmap_give_no_value():
    returns = np.array([0.1 + 0.1j] * 4 + [9.0 + 9.0j] * 9 + [np.nan])
    assert np.isnan(unmarked(grid(np.zeros((10, 10))), returns))
