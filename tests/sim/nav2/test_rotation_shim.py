"""The rotation shim against paths in every direction."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim.middleware.geometry import Pose2D, wrap_angle
from sim.nav2.costmap import CostGrid
from sim.nav2.rotation_shim import ANGULAR_DIST_THRESHOLD, RotationShim

GRID = CostGrid(np.zeros((60, 60), np.uint8), 0.05, -1.5, -1.5)
HERE = Pose2D()


def plan(bearing, start=0.0, length=1.2):
    along = np.arange(start, length, 0.025)
    return np.column_stack(
        [along * math.cos(bearing), along * math.sin(bearing), np.full(len(along), bearing)]
    )


def shim(poses):
    made = RotationShim()
    made.set_plan(poses)
    return made


@given(st.floats(-3.1, 3.1))
def test_the_robot_turns_on_the_spot_towards_a_path_it_does_not_face_and_drives_along_others(
    bearing,
):
    forward, turning = shim(plan(bearing)).compute(GRID, HERE, (0.0, 0.0), HERE).twist
    if abs(wrap_angle(bearing)) > ANGULAR_DIST_THRESHOLD + 1e-6:
        assert forward == 0.0
        assert turning * bearing > 0.0
    elif abs(bearing) < ANGULAR_DIST_THRESHOLD - 1e-6:
        assert forward > 0.0


def test_it_turns_as_fast_as_the_speed_limit_lets_dwb_turn():
    turner = shim(plan(2.0))
    assert turner.compute(GRID, HERE, (0.0, 0.0), HERE).twist == (0.0, 1.0)
    turner.limit_speed(50.0, percentage=True)
    assert turner.compute(GRID, HERE, (0.0, 0.0), HERE).twist == (0.0, 0.5)


def test_once_it_faces_the_path_dwb_drives_until_the_next_path_comes():
    turner = shim(plan(1.0))
    facing, away = Pose2D(0.0, 0.0, 1.0), Pose2D(0.0, 0.0, -1.0)
    assert turner.compute(GRID, HERE, (0.0, 0.0), HERE).twist[0] == 0.0
    assert turner.compute(GRID, facing, (0.0, 0.0), HERE).twist[0] > 0.0
    assert not turner._facing
    turner.compute(GRID, away, (0.0, 0.0), HERE)
    assert not turner._facing
    turner.set_plan(plan(1.0))
    assert turner.compute(GRID, away, (0.0, 0.0), HERE).twist[0] == 0.0


def test_the_path_behind_the_robot_does_not_turn_it():
    assert shim(plan(0.0, start=-1.0)).compute(GRID, HERE, (0.0, 0.0), HERE).twist[0] > 0.0


def test_a_path_shorter_than_the_sampling_distance_is_left_to_dwb():
    made = shim(plan(1.5, length=0.2))
    made.compute(GRID, HERE, (0.0, 0.0), HERE)
    assert not made._facing


def test_a_plan_that_is_nowhere_near_is_not_turned_to():
    far = plan(1.5) + np.array([9.0, 0.0, 0.0])
    turner = shim(far)
    for _ in range(2):
        assert turner.compute(GRID, HERE, (0.0, 0.0), HERE).twist is None
