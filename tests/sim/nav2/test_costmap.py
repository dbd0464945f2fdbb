import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.ndimage import distance_transform_edt

from oracle_pipeline.bags.types import deserialize, message_class, serialize
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import header
from sim.nav2.costmap import (
    FREE_SPACE,
    INSCRIBED,
    LETHAL,
    NO_INFORMATION,
    Costmap2D,
    costmap_message,
    footprint_cost,
    occupancy_grid,
)
from sim.nav2.costmap_layers import Observation, ObstacleLayer, shift, static_costs
from sim.nav2.footprint import FOOTPRINT, INSCRIBED_RADIUS
from sim.nav2.inflation import InflationLayer
from sim.nav2.laser import scan_points

LaserScan = message_class("sensor_msgs/msg/LaserScan")

ELSEWHERE = FOOTPRINT + np.array([9.0, 9.0])  # a robot that stands off the grid

cost_grids = hnp.arrays(
    np.uint8,
    st.tuples(st.integers(1, 30), st.integers(1, 30)),
    elements=st.sampled_from([FREE_SPACE] * 20 + [LETHAL, NO_INFORMATION]),
)


def empty_grid(size=80, origin=-2.0):
    return Costmap2D(np.zeros((size, size), np.uint8), 0.05, origin, origin, "map")


def seen(*points, sensor=(0.02, 0.02)):
    return Observation(0, *sensor, np.array(points, dtype=float).reshape(-1, 2))


def layer_after(*observations, margin=0.0, grid=None):
    grid = grid or empty_grid()
    layer = ObstacleLayer(grid, margin=margin)
    layer.update(grid, observations, ELSEWHERE)
    return layer.costs


def at(costs, x, y):
    grid = empty_grid()
    column, row = grid.cell(x, y)
    return costs[row, column]


# -- footprint and inflation -----------------------------------------------------------------


def test_footprint_is_a_padded_16_gon_with_nav2s_radii():
    assert FOOTPRINT.shape == (16, 2)
    assert round(INSCRIBED_RADIUS, 4) == 0.2264
    assert round(float(np.hypot(*FOOTPRINT.T).max()), 4) == 0.2341


@pytest.mark.parametrize(
    ("cells", "cost"),
    [
        ((0, 0), 254),
        ((4, 0), 253),  # 0.20 m, within the inscribed radius
        ((3, 3), 253),  # 0.212 m
        ((4, 3), 234),  # 0.25 m: 252 exp(-3 (0.25 - 0.22645)) = 234.8
        ((6, 0), 202),  # 0.30 m
        ((8, 0), 149),  # 0.40 m
        ((6, 8), 110),  # 0.50 m
        ((11, 0), 95),  # 0.55 m
        ((11, 1), 0),
        ((12, 0), 0),
    ],
)
def test_costs_around_one_obstacle_are_nav2s(cells, cost):
    costs = np.zeros((40, 40), np.uint8)
    costs[20, 20] = LETHAL
    InflationLayer(0.05, INSCRIBED_RADIUS).add_to(costs)
    for x, y in (cells, cells[::-1], (-cells[0], cells[1]), (cells[0], -cells[1])):
        assert costs[20 + y, 20 + x] == cost


@given(cost_grids)
def test_every_cell_is_inflated_by_its_nearest_obstacle_only(costs):
    before = costs.copy()
    InflationLayer(0.05, INSCRIBED_RADIUS).add_to(costs)
    if not np.any(before == LETHAL):
        assert np.array_equal(costs, before)
        return
    distance = distance_transform_edt(before != LETHAL) * 0.05
    decay = np.floor(252.0 * np.exp(-3.0 * (distance - INSCRIBED_RADIUS)))
    expected = np.where(distance <= INSCRIBED_RADIUS, INSCRIBED, decay)
    expected[distance > 0.55 + 1e-9] = FREE_SPACE
    expected[distance == 0.0] = LETHAL
    unknown = (before == NO_INFORMATION) & (expected < INSCRIBED)
    expected[unknown] = NO_INFORMATION
    assert np.array_equal(costs, expected)


# -- obstacles -------------------------------------------------------------------------------


def test_beam_frees_what_it_crosses_and_marks_where_it_ends():
    costs = layer_after(seen((1.02, 0.02)))
    assert at(costs, 1.02, 0.02) == LETHAL
    assert np.all(costs[40, 40:60] == FREE_SPACE)
    assert np.sum(costs != NO_INFORMATION) == 21


@given(st.integers(-30, 30), st.integers(-30, 30))
def test_a_beam_crosses_one_cell_a_step_the_nearest_to_it(columns, rows):
    costs = layer_after(seen((0.025 + 0.05 * columns, 0.025 + 0.05 * rows), sensor=(0.025, 0.025)))
    steps = max(abs(columns), abs(rows), 1)
    crossed = np.zeros_like(costs, bool)
    for step in range(steps + 1):
        share = step / steps
        crossed[40 + round(share * rows), 40 + round(share * columns)] = True
    assert np.array_equal(costs != NO_INFORMATION, crossed)


def test_obstacles_are_marked_up_to_2_5_m_and_space_freed_up_to_3_m():
    grid = empty_grid(200, -5.0)
    for distance, marked, freed in ((2.4, True, 48), (2.6, False, 53), (4.0, False, 61)):
        layer = ObstacleLayer(grid)
        layer.update(grid, [seen((0.02 + distance, 0.02))], ELSEWHERE)
        assert np.any(layer.costs == LETHAL) == marked
        assert np.sum(layer.costs == FREE_SPACE) == freed


@pytest.mark.parametrize("nowhere", [(math.nan, math.nan), (math.nan, 0.5), (0.5, math.nan)])
def test_points_of_a_false_scan_that_are_nowhere_neither_mark_nor_free(nowhere):
    costs = layer_after(seen(nowhere, (0.52, 0.02)))
    assert np.array_equal(costs, layer_after(seen((0.52, 0.02))))


def test_marks_win_over_clearing_of_the_same_update_whatever_the_order_of_sources():
    near, far = seen((0.52, 0.02)), seen((1.02, 0.02))
    for pair in ((near, far), (far, near)):
        costs = layer_after(*pair)
        assert at(costs, 0.52, 0.02) == LETHAL
        assert at(costs, 1.02, 0.02) == LETHAL


def test_an_obstacle_that_is_later_measured_through_is_cleared():
    grid = empty_grid()
    layer = ObstacleLayer(grid)
    layer.update(grid, [seen((0.52, 0.02))], ELSEWHERE)
    layer.update(grid, [seen((1.02, 0.02))], ELSEWHERE)
    assert at(layer.costs, 0.52, 0.02) == FREE_SPACE


def test_voxels_keep_what_lies_within_two_cells_of_a_hit():
    grid = empty_grid()
    layer = ObstacleLayer(grid, margin=0.10)
    layer.update(grid, [seen((0.97, 0.02)), seen((0.82, 0.02))], ELSEWHERE)
    layer.update(grid, [seen((1.02, 0.02))], ELSEWHERE)
    assert at(layer.costs, 0.97, 0.02) == LETHAL
    assert at(layer.costs, 0.82, 0.02) == FREE_SPACE


@pytest.mark.slow
def test_space_under_the_robot_is_free():
    grid = empty_grid()
    layer = ObstacleLayer(grid)
    layer.update(grid, [seen((0.12, 0.02)), seen((0.32, 0.02))], FOOTPRINT)
    assert at(layer.costs, 0.12, 0.02) == FREE_SPACE
    assert at(layer.costs, 0.32, 0.02) == LETHAL


points = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0))


@given(st.lists(points, max_size=30), points)
def test_beams_from_and_to_anywhere_change_no_cell_out_of_range_of_the_sensor(hits, sensor):
    costs = layer_after(seen(*hits, sensor=sensor))
    rows, columns = np.nonzero(costs != NO_INFORMATION)
    x, y = -2.0 + (columns + 0.5) * 0.05, -2.0 + (rows + 0.5) * 0.05
    assert np.all(np.hypot(x - sensor[0], y - sensor[1]) < 3.0 + 0.08)
    for hit in hits:
        near = math.dist(hit, sensor) < 2.5 and empty_grid().contains(*hit)
        if near:
            assert at(costs, *hit) == LETHAL


def test_adding_a_layer_raises_costs_and_fills_the_unknown():
    grid = empty_grid(4)
    layer = ObstacleLayer(grid)
    layer.costs[0] = [FREE_SPACE, FREE_SPACE, LETHAL, NO_INFORMATION]
    costs = np.full((4, 4), 100, np.uint8)
    costs[0, 1] = NO_INFORMATION
    layer.add_to(costs)
    assert costs[0].tolist() == [100, FREE_SPACE, LETHAL, 100]
    assert np.all(costs[1:] == 100)


@given(
    st.integers(-9, 9),
    st.integers(-9, 9),
    hnp.arrays(np.uint8, (6, 7), elements=st.integers(0, 254)),
)
def test_shifting_keeps_every_cell_at_its_place_in_the_world(columns, rows, costs):
    moved = shift(costs, columns, rows, NO_INFORMATION)
    for row in range(6):
        for column in range(7):
            source = (row + rows, column + columns)
            inside = 0 <= source[0] < 6 and 0 <= source[1] < 7
            assert moved[row, column] == (costs[source] if inside else NO_INFORMATION)


def test_static_map_is_trinary_with_unknown_space():
    occupancy = np.array([[-1, 0, 50, 99, 100]], np.int8)
    assert static_costs(occupancy).tolist() == [[255, 0, 0, 0, 254]]


def test_readings_that_saw_nothing_yield_no_point():
    ranges = np.array([1.0, np.inf, np.nan, -np.inf, 0.05, 20.0, 2.0], np.float32)
    no_intensities = np.zeros(0, np.float32)
    quarter = math.pi / 2.0
    scan = LaserScan(
        header(0, "base_scan"), 0.0, 6 * quarter, quarter, 0.0, 0.0, 0.12, 20.0, ranges,
        no_intensities,
    )  # fmt: skip
    assert scan_points(scan, Pose2D()) == pytest.approx(
        np.array([[1.0, 0.0], [-2.0, 0.0]]), abs=1e-6
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("first", "step"),
    [(math.nan, 0.1), (math.inf, 0.1), (0.0, -math.inf), (0.0, math.nan), (1e308, 1e308)],
)
def test_beams_at_no_finite_angle_end_nowhere_and_give_no_warning(first, step):
    scan = LaserScan(
        header(0, "base_scan"), first, 0.0, step, 0.0, 0.0, 0.12, 20.0,
        np.ones(4, np.float32), np.zeros(0, np.float32),
    )  # fmt: skip
    assert np.isnan(scan_points(scan, Pose2D())[1:]).all()  # 1e308 itself is finite


# -- reading and messages --------------------------------------------------------------------


def test_footprint_cost_is_that_of_the_outline_only():
    grid = empty_grid()
    column, row = grid.cell(0.22, 0.0)
    grid.costs[row, column] = LETHAL
    assert footprint_cost(grid, Pose2D()) == LETHAL
    assert footprint_cost(grid, Pose2D(0.0, 0.0, math.pi / 16.0)) == LETHAL
    assert footprint_cost(grid, Pose2D(-0.1, 0.0)) == FREE_SPACE
    assert footprint_cost(grid, Pose2D(0.22, 0.0)) == FREE_SPACE  # it surrounds the obstacle
    assert footprint_cost(grid, Pose2D(1.9, 0.0)) == NO_INFORMATION


def test_costmap_message_brings_the_grid_back():
    grid = empty_grid(7)
    grid.costs[2, 3] = 99
    msgtype = "nav2_msgs/msg/Costmap"
    message = deserialize(serialize(costmap_message(5, grid), msgtype), msgtype)
    assert message.metadata.layer == "master"
    back = Costmap2D.from_message(message)
    assert np.array_equal(back.costs, grid.costs)
    assert (back.origin_x, back.origin_y, back.frame) == (-2.0, -2.0, "map")
    assert back.resolution == pytest.approx(0.05)


def test_costmap_message_does_not_change_with_the_grid():
    grid = empty_grid(7)
    message = costmap_message(5, grid)
    grid.costs[:] = LETHAL
    assert not message.data.any()


def test_occupancies_are_nav2s_translation_of_costs():
    grid = empty_grid(16)
    grid.costs[:] = np.arange(256, dtype=np.uint8).reshape(16, 16)
    data = occupancy_grid(0, grid).data
    assert data[[0, 1, 252, 253, 254, 255]].tolist() == [0, 1, 98, 99, 100, -1]
    assert np.all(np.diff(data[:255].astype(int)) >= 0)
