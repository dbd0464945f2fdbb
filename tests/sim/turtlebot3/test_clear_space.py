"""While the robot is clear of all pieces, the physics needs none of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.middleware.geometry import Pose2D
from sim.turtlebot3.arena import HEXAGON, Arena, Cylinder
from sim.turtlebot3.clear_space import CENTRE_X, RADIUS, ClearSpace
from sim.turtlebot3.floor_plans import draw_arena
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.world import World

SPACE = ClearSpace(HEXAGON)


def pose(x: float, y: float, yaw: float) -> np.ndarray:
    return np.array([[x, y, 0.01, math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)]])


@given(
    st.sampled_from([HEXAGON, draw_arena("house", 1), draw_arena("random", 2)]),
    st.floats(-4.0, 4.0),
    st.floats(-4.0, 4.0),
    st.floats(-math.pi, math.pi),
)
def test_where_it_is_clear_the_body_is_off_every_surface(
    arena: Arena, x: float, y: float, yaw: float
) -> None:
    centre = np.array([[x + CENTRE_X * math.cos(yaw), y + CENTRE_X * math.sin(yaw)]])
    clearance = arena.clearance(centre)[0]
    if ClearSpace(arena).holds(pose(x, y, yaw)):
        assert clearance >= RADIUS - 0.012  # the centre stands 5 cm above the floor
    elif np.hypot(x, y) < 3.0:  # farther out the corners of blocks and ring are cut generously
        assert clearance < RADIUS + 0.2


def test_a_tilted_robot_is_where_its_body_is() -> None:
    x = 1.1 * 0.5 + 0.15
    assert SPACE.holds(pose(-2.0, -0.5, 0.0))
    assert not SPACE.holds(pose(x + 0.2, 0.0, 0.0)), "a pillar is 0.25 m from the centre"
    nose_down = np.array([[-2.0, -0.5, 0.1, math.cos(0.7), 0.0, math.sin(0.7), 0.0]])
    assert SPACE.holds(nose_down)
    assert not SPACE.holds(np.full((1, 7), np.nan))


@pytest.mark.parametrize("obstacles", [(), (Cylinder("obstacle", -1.0, -0.6),)])
def test_a_drive_into_a_pillar_is_the_same_without_the_shortcut(
    obstacles: tuple[Cylinder, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def drive() -> tuple[object, ...]:
        world = World(WorldParameters(Pose2D(-2.0, -0.5, 0.15), 0.9, 1.05, obstacles))
        seen = []
        for step, (left, right) in enumerate([(6.0, 6.3), (7.0, 5.0), (-5.0, -5.0), (3.0, 6.0)]):
            world.advance_to(3_000_000_000 * step)
            world.command_wheels(left, right)
            for time_ms in range(3000 * step, 3000 * (step + 1), 30):
                world.advance_to(time_ms * 1_000_000)
                samples = world.imu((time_ms + 30) * 1_000_000)
                seen.append((world.pose, world.twist, samples.linear_accelerations.tolist()))
        return seen, world.touches

    quick = drive()
    monkeypatch.setattr(ClearSpace, "holds", lambda *_: False)
    assert drive() == quick
    assert quick[1], "the drive ends at a pillar"
