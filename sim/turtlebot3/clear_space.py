"""Tests whether the robot is too far from all pieces of the world to touch any.

The robot fits into a ball around a point of its body, whatever its tilt. Where the ball's vertical
projection meets no piece, the robot can touch only the floor.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats
from sim.turtlebot3.arena import Arena, Cylinder, Prism

# The ball: its centre in the robot's frame [m], and its radius with 1 cm to spare [m]. Farthest
# from the centre are the treads of the wheels, 0.193 m.
CENTRE_X, CENTRE_Z = -0.064, 0.05
RADIUS = 0.205


class ClearSpace:
    """The space in which the robot touches nothing but the floor.

    Parameters
    ----------
    arena
        The outer wall and the obstacles inside.
    obstacles
        Additional obstacles.
    """

    def __init__(self, arena: Arena, obstacles: Sequence[Cylinder] = ()) -> None:
        self._boundary = _rows([arena.boundary])
        self._blocks = _rows(arena.blocks)
        pillars = (*arena.pillars, *obstacles)
        self._pillars = np.array([(p.x, p.y, p.radius) for p in pillars]).reshape(-1, 3)

    def move_last(self, x: float, y: float) -> None:
        """Move the last additional obstacle to a place [m]."""
        self._pillars[-1, :2] = x, y

    def holds(self, poses: Floats) -> bool:
        """Return whether the robot is clear of all pieces at each of some poses.

        Parameters
        ----------
        poses
            Shape (n, 7): x, y, z of ``base_footprint`` [m], and its quaternion w, x, y, z.
        """
        return _all_clear(poses, self._boundary, self._blocks, self._pillars)


def _rows(blocks: Iterable[Prism]) -> Floats:
    """Return x and y of each block's centre, then its three slabs, shape (n, 11)."""
    return np.array([(b.x, b.y, *b.slabs().ravel()) for b in blocks]).reshape(-1, 11)


@jit
def _all_clear(poses: Floats, boundary: Floats, blocks: Floats, pillars: Floats) -> bool:
    for i in range(len(poses)):
        w, qx, qy, qz = poses[i, 3], poses[i, 4], poses[i, 5], poses[i, 6]
        x = poses[i, 0] + (1.0 - 2.0 * (qy * qy + qz * qz)) * CENTRE_X
        x += 2.0 * (qx * qz + w * qy) * CENTRE_Z
        y = poses[i, 1] + 2.0 * (qx * qy + w * qz) * CENTRE_X + 2.0 * (qy * qz - w * qx) * CENTRE_Z
        if not (
            _beyond(x, y, boundary[0]) < -RADIUS  # also false for what is not a number
            and _is_outside(x, y, blocks)
            and _is_away(x, y, pillars)
        ):
            return False
    return True


@jit
def _beyond(x: float, y: float, block: Floats) -> float:
    """Return the distance of a point from the slab of a block that is farthest from it [m]."""
    out = -np.inf
    for i in range(2, 11, 3):
        along = block[i] * (x - block[0]) + block[i + 1] * (y - block[1])
        out = max(out, abs(along) - block[i + 2])
    return out


@jit
def _is_outside(x: float, y: float, blocks: Floats) -> bool:
    for i in range(len(blocks)):  # noqa: SIM110 -- numba has no generators of this kind
        if _beyond(x, y, blocks[i]) < RADIUS:
            return False
    return True


@jit
def _is_away(x: float, y: float, pillars: Floats) -> bool:
    for i in range(len(pillars)):
        if math.hypot(x - pillars[i, 0], y - pillars[i, 1]) < pillars[i, 2] + RADIUS:
            return False
    return True
