"""Whether the robot is clear of every piece of the world, so that it can touch none.

The robot fits into a ball around a point of its body, however it is tilted: where the ball's
shadow on the floor meets no piece, there is no contact but with the floor.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit
from sim.turtlebot3.arena import Cylinder, Hexagon

# The ball: its centre in the robot's frame [m], and its radius with 1 cm to spare [m]. Farthest
# from the centre are the treads of the wheels, 0.193 m.
CENTRE_X, CENTRE_Z = -0.064, 0.05
RADIUS = 0.205

_SIDES = np.array([(math.cos(a), math.sin(a)) for a in (math.pi / 6, math.pi / 2, 5 * math.pi / 6)])


class ClearSpace:
    """The space in which the robot touches nothing but the floor.

    Parameters
    ----------
    ring
        The wall around, by its inside.
    blocks, pillars
        What stands in it.
    """

    def __init__(
        self, ring: Hexagon, blocks: Sequence[Hexagon], pillars: Sequence[Cylinder]
    ) -> None:
        self._ring = ring.apothem
        self._blocks = np.array([(b.x, b.y, b.apothem) for b in blocks]).reshape(-1, 3)
        self._pillars = np.array([(p.x, p.y, p.radius) for p in pillars]).reshape(-1, 3)

    def holds(self, poses: NDArray[np.float64]) -> bool:
        """Tell whether the robot is clear of all pieces at each of some poses.

        Parameters
        ----------
        poses
            Shape (n, 7): x, y, z of ``base_footprint`` [m], and its quaternion w, x, y, z.
        """
        return _all_clear(poses, self._ring, self._blocks, self._pillars)


@jit
def _all_clear(
    poses: NDArray[np.float64],
    ring: float,
    blocks: NDArray[np.float64],
    pillars: NDArray[np.float64],
) -> bool:
    for i in range(len(poses)):
        w, qx, qy, qz = poses[i, 3], poses[i, 4], poses[i, 5], poses[i, 6]
        x = poses[i, 0] + (1.0 - 2.0 * (qy * qy + qz * qz)) * CENTRE_X
        x += 2.0 * (qx * qz + w * qy) * CENTRE_Z
        y = poses[i, 1] + 2.0 * (qx * qy + w * qz) * CENTRE_X + 2.0 * (qy * qz - w * qx) * CENTRE_Z
        if not (
            _from_centre(x, y) < ring - RADIUS  # also false for what is not a number
            and _is_outside(x, y, blocks)
            and _is_away(x, y, pillars)
        ):
            return False
    return True


@jit
def _from_centre(x: float, y: float) -> float:
    """Return how far a point is out along the axis of a hexagon's sides that is farthest."""
    out = 0.0
    for i in range(len(_SIDES)):
        out = max(out, abs(_SIDES[i, 0] * x + _SIDES[i, 1] * y))
    return out


@jit
def _is_outside(x: float, y: float, blocks: NDArray[np.float64]) -> bool:
    for i in range(len(blocks)):
        if _from_centre(x - blocks[i, 0], y - blocks[i, 1]) < blocks[i, 2] + RADIUS:
            return False
    return True


@jit
def _is_away(x: float, y: float, pillars: NDArray[np.float64]) -> bool:
    for i in range(len(pillars)):
        if math.hypot(x - pillars[i, 0], y - pillars[i, 1]) < pillars[i, 2] + RADIUS:
            return False
    return True
