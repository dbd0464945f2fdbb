import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.lidar import map_consistency
from oracle_pipeline.features.lidar.map_consistency import Map, MapGrid
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    World,
    believed_message,
    driving,
    extract,
    grid_message,
    recording,
)

PLUGINS = map_consistency.register_features()
RESOLUTION = 0.05
DISC = (1.125, 0.125, 0.1)


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    return lambda recorded: extract(PLUGINS, recorded, tmp_path_factory.mktemp("bag"))


def room(half_m: float, unknown_m: float = 0.5) -> np.ndarray:
    """Cells of a square room with walls of one cell, with unknown cells around."""
    inside, border = round(2 * half_m / RESOLUTION), round(unknown_m / RESOLUTION)
    cells = np.full((inside + 2, inside + 2), 100)
    cells[1:-1, 1:-1] = 0
    return np.pad(cells, border, constant_values=-1)


def corner(cells: np.ndarray) -> complex:
    return -RESOLUTION * len(cells) / 2 * (1 + 1j)


def world(half_m: float = 2.0, yaw: float = 0.0) -> Map:
    cells = room(half_m).astype(np.int8)
    turn = np.exp(1j * yaw)
    return Map.of(
        MapGrid(PlanarPose(np.asarray(turn * corner(cells)), np.asarray(turn)), RESOLUTION, cells)
    )


def with_map(scanner, cells, offset=0j):
    """A drive of a robot whose odometry frame has an offset in the map, and knows it."""
    poses = [
        (t, "/amcl_pose", believed_message(t, driving(t)[0] + offset, driving(t)[1]))
        for t in range(8)
    ]
    grid = (0.0, "/map", grid_message(0.0, cells, RESOLUTION, corner(cells) + offset))
    return sorted([*recording([scanner], driving), grid, *poses], key=lambda each: each[0])


@given(st.floats(-np.pi, np.pi), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_rays_end_in_the_wall(bearing, x, y):
    start, ray = np.array([[complex(x, y)]]), np.exp(1j * np.array([[bearing]]))
    end = (start + world().cast(start, ray) * ray).item()
    assert 2.0 - 1e-4 <= max(abs(end.real), abs(end.imag)) <= 2.0 + RESOLUTION


def test_a_turned_map_is_the_same_map():
    turn = np.exp(0.7j)
    reached = world(yaw=0.7).cast(np.array([[0j]]), turn * np.array([[1.0, 1j, -1.0]]))
    assert reached == pytest.approx(2.0, abs=0.02)


def test_rays_into_unknown_space_are_invalid():
    cells = room(2.0).astype(np.int8)
    cells[len(cells) // 2 - 5 : len(cells) // 2 + 5, -11] = 0  # a door; unknown behind it
    pose = PlanarPose(np.asarray(corner(cells)), np.asarray(1.0 + 0j))
    reached = Map.of(MapGrid(pose, RESOLUTION, cells)).cast(np.zeros((1, 1)), np.array([[1.0, 1j]]))
    assert np.isnan(reached[0, 0])
    assert reached[0, 1] == pytest.approx(2.0, abs=0.02)


def test_rays_from_inside_a_wall_or_off_the_map_are_invalid():
    starts = np.array([[2.01 + 0j], [50.0 + 0j]])
    assert np.isnan(world().cast(starts, np.array([[1j]]))).all()


@pytest.mark.parametrize("offset", [0j, 3.0 - 1.0j])
def test_scans_of_the_room_fit_its_map(extracted, offset):
    values, *_ = extracted(with_map(Scanner("/scan"), room(2.0), offset))
    assert values["residual"] < 0.03
    assert values["unexpected"] == 0.0
    assert values["unexpected_persistence"] == 0.0
    assert values["looked_through"] == 0.0


def test_an_object_that_the_map_lacks_is_unexpected(extracted):
    values, where, _ = extracted(with_map(Scanner("/scan", world=World((DISC,))), room(2.0)))
    assert values["unexpected"] > 0.01
    assert values["unexpected_persistence"] > 0.3
    assert values["looked_through"] == 0.0
    assert where["unexpected"] == "/scan"


def test_a_return_from_behind_a_wall_is_detected(extracted):
    values, *_ = extracted(with_map(Scanner("/scan", world=World(room_m=3.0)), room(2.0)))
    assert values["looked_through"] == pytest.approx(1.0, abs=0.05)
    assert values["unexpected"] == 0.0


@pytest.mark.parametrize(
    ("lacking", "reason"),
    [("/map", "no map"), ("/amcl_pose", "no pose of localisation"), ("/odom", "no odometry")],
)
def test_missing_requirements_are_reported(extracted, lacking, reason):
    recorded = [each for each in with_map(Scanner("/scan"), room(2.0)) if each[1] != lacking]
    _, _, missing = extracted(recorded)
    assert missing["residual"] == reason
