"""Rays end where MuJoCo's rays end."""

import math
import platform
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.middleware.geometry import Pose2D
from sim.turtlebot3.arena import HEXAGON, Cylinder
from sim.turtlebot3.floor_plans import draw_arena
from sim.turtlebot3.mjcf import WorldParameters, mjcf
from sim.turtlebot3.world import World

OBSTACLE = Cylinder("obstacle", -0.6, 0.55, 0.1)
PARAMETERS = [
    WorldParameters(Pose2D(), obstacles=(OBSTACLE,), arena=arena)
    for arena in (HEXAGON, draw_arena("house", 1), draw_arena("random", 2))
]
BEARINGS = np.linspace(0.0, 6.28, 360)
RANGE_MAX_M = 4.0


class Both(NamedTuple):
    """The same world as ours and as MuJoCo's."""

    world: World
    model: mujoco.MjModel
    data: mujoco.MjData


def both(parameters: WorldParameters) -> Both:
    model = mujoco.MjModel.from_xml_string(mjcf(parameters))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return Both(World(parameters), model, data)


WORLDS = list(map(both, PARAMETERS))


def by_mujoco(there: Both, pose: Pose2D, height: float) -> np.ndarray:
    directions = np.zeros((len(BEARINGS), 3))
    directions[:, 0] = np.cos(BEARINGS + pose.yaw)
    directions[:, 1] = np.sin(BEARINGS + pose.yaw)
    distances, geoms = np.empty(len(BEARINGS)), np.empty(len(BEARINGS), np.int32)
    mujoco.mj_multiRay(
        there.model, there.data, np.array([pose.x, pose.y, height]), directions.ravel(),
        np.array([1, 0, 0, 0, 0, 0], np.uint8), 1, -1, geoms, distances, None, len(BEARINGS),
        RANGE_MAX_M,
    )  # fmt: skip
    distances[(distances < 0.0) | (distances > RANGE_MAX_M)] = np.inf
    return distances


@given(
    st.sampled_from(WORLDS),
    st.floats(-5.0, 5.0),
    st.floats(-5.0, 5.0),
    st.floats(-math.pi, math.pi),
    st.sampled_from([0.132, 0.01, 0.499, 0.6, 1.45]),  # above pillars, above blocks
)
def test_rays_end_where_those_of_mujoco_do(
    there: Both, x: float, y: float, yaw: float, height: float
) -> None:
    start = there.world.pose
    pose = start.compose(Pose2D(x, y, yaw))
    found = there.world.scan(Pose2D(x, y, yaw), height, BEARINGS, RANGE_MAX_M)
    expected = by_mujoco(there, pose, height)
    assert found == pytest.approx(expected, rel=1e-12)
    if platform.machine() == "x86_64":  # others may fuse a multiplication and an addition
        assert np.array_equal(found, expected)
