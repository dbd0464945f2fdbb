import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sim.nav2 import navfn
from sim.nav2.costmap import FREE_SPACE, LETHAL, NO_INFORMATION, Costmap2D

RESOLUTION = 0.05
EVERYWHERE = (0, 0)  # the border is never reached, so a wave sent there settles everything


def grid_of(costs):
    return Costmap2D(np.asarray(costs, np.uint8), RESOLUTION, 0.0, 0.0, "map")


def centre(column, row):
    return ((column + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION)


def length(path):
    return np.hypot(*np.diff(path, axis=0).T).sum()


def costs_under(grid, path):
    columns, rows = np.floor(path / RESOLUTION).astype(int).T
    return grid.costs[rows, columns]


def dijkstra_distances(cells, start):
    """Cost of the cheapest 4-connected walk, entering a cell at its cost: the slow, obvious way."""
    height, width = cells.shape
    index = np.arange(cells.size).reshape(height, width)
    edges = [
        pair
        for a, b in ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:]))
        for pair in (*zip(a.flat, b.flat, strict=True), *zip(b.flat, a.flat, strict=True))
    ]
    tail, head = np.array(edges).T
    free = (cells.flat[head] < navfn.OBSTACLE) & (cells.flat[tail] < navfn.OBSTACLE)
    weights = cells.flat[head[free]]
    graph = coo_array((weights, (tail[free], head[free])), shape=(cells.size, cells.size))
    return dijkstra(graph.tocsr(), indices=index[start]).reshape(height, width)


costs = st.sampled_from([FREE_SPACE, 40, 120, 252, 253, LETHAL, NO_INFORMATION])
grids = hnp.arrays(np.uint8, st.tuples(st.integers(4, 14), st.integers(4, 14)), elements=costs)


@st.composite
def problems(draw):
    """A grid and two free cells of it, as (column, row)."""
    grid = grid_of(draw(grids))
    for cell in ((1, 1), (1, 2), (2, 1)):
        grid.costs[cell] = FREE_SPACE
    free = np.argwhere(navfn.cell_costs(grid) < navfn.OBSTACLE)[:, ::-1].tolist()
    return grid, tuple(draw(st.sampled_from(free))), tuple(draw(st.sampled_from(free)))


def test_cost_translation_is_navfns():
    grid = grid_of(np.zeros((3, 9)))
    grid.costs[1, 1:8] = [0, 1, 100, 252, 253, 254, 255]
    assert navfn.cell_costs(grid)[1].tolist() == [254, 50, 50, 130, 251, 254, 254, 253, 254]


@given(problems())
def test_wavefront_reaches_what_dijkstra_reaches_at_a_cost_the_interpolation_allows(problem):
    grid, start, _ = problem
    cells = navfn.cell_costs(grid)
    expected = dijkstra_distances(cells, start[::-1])
    potential = navfn.wavefront(cells, *start, *EVERYWHERE)
    reached = np.isfinite(potential)
    assert np.array_equal(reached, np.isfinite(expected))
    # The fit adds 0.704 to 1.01 of a cell's cost, where a walk along the axes adds all of it.
    assert np.all(potential[reached] >= 0.704 * expected[reached] - 1e-6)
    assert np.all(potential[reached] <= 1.011 * expected[reached] + 1e-6)


@given(problems())
def test_path_exists_where_dijkstra_finds_one_and_enters_no_obstacle(problem):
    grid, start, goal = problem
    cells = navfn.cell_costs(grid)
    path = navfn.plan(grid, centre(*start), centre(*goal), tolerance=0.0)
    assert (path is not None) == np.isfinite(dijkstra_distances(cells, start[::-1])[goal[::-1]])
    if path is not None:
        assert path[-1] == pytest.approx(centre(*goal))
        assert path[0] == pytest.approx(centre(*start))
        assert np.all(navfn._TRANSLATION[costs_under(grid, path)] < navfn.OBSTACLE)
        assert np.hypot(*np.diff(path, axis=0).T).max() < 2.2 * RESOLUTION


@given(st.tuples(st.integers(5, 94), st.integers(5, 94)))
def test_in_the_open_the_path_is_nearly_straight_with_poses_half_a_cell_apart(goal):
    grid = grid_of(np.zeros((100, 100)))
    path = navfn.plan(grid, centre(50, 50), centre(*goal))
    straight = np.hypot(goal[0] - 50, goal[1] - 50) * RESOLUTION
    assert length(path) <= 1.05 * straight + 0.01
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert np.all(steps[1:-1] == pytest.approx(0.025))


def test_path_goes_through_the_gap_in_a_wall():
    grid = grid_of(np.zeros((40, 40)))
    grid.costs[:, 20] = LETHAL
    grid.costs[30, 20] = FREE_SPACE
    path = navfn.plan(grid, centre(10, 10), centre(30, 10))
    crossing = path[np.floor(path[:, 0] / RESOLUTION) == 20]
    assert len(crossing)
    assert np.all(np.floor(crossing[:, 1] / RESOLUTION) == 30)
    around = 2 * np.hypot(10, 20) * RESOLUTION
    assert around <= length(path) <= 1.1 * around


def test_path_prefers_the_cheap_side():
    grid = grid_of(np.zeros((41, 41)))
    grid.costs[20, 20] = LETHAL  # in the way
    grid.costs[21:, 15:26] = 200
    path = navfn.plan(grid, centre(5, 20), centre(35, 20))
    assert path[:, 1].min() < 20 * RESOLUTION
    assert costs_under(grid, path).max() < 200


def test_closed_wall_leaves_no_path():
    grid = grid_of(np.zeros((40, 40)))
    grid.costs[:, 20] = LETHAL
    assert navfn.plan(grid, centre(10, 10), centre(35, 10)) is None


def test_goal_in_an_obstacle_moves_within_the_tolerance_and_not_farther():
    grid = grid_of(np.zeros((60, 60)))
    grid.costs[20:41, 30:41] = LETHAL
    path = navfn.plan(grid, centre(10, 30), centre(34, 30))
    assert path[-1] == pytest.approx(centre(29, 30))
    assert navfn.plan(grid, centre(10, 30), centre(34, 30), tolerance=0.2) is None


def test_unknown_space_is_passable_at_a_high_cost():
    grid = grid_of(np.full((30, 60), NO_INFORMATION))
    grid.costs[5, 5:55] = grid.costs[25, 5:55] = FREE_SPACE
    path = navfn.plan(grid, centre(10, 5), centre(50, 25))
    assert path is not None
    # It crosses the unknown once, straight, instead of cutting the corner through it.
    assert np.sum(costs_under(grid, path) == NO_INFORMATION) < 60


def test_robot_inside_an_inscribed_area_has_no_way_out():
    grid = grid_of(np.zeros((20, 20)))
    grid.costs[4:7, 4:7] = 253
    assert navfn.plan(grid, centre(5, 5), centre(17, 17)) is None


def test_ends_off_the_grid_have_no_path():
    grid = grid_of(np.zeros((20, 20)))
    assert navfn.plan(grid, (-0.1, 0.5), centre(5, 5)) is None
    assert navfn.plan(grid, centre(5, 5), (0.5, 1.1)) is None
