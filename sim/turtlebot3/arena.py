"""The turtlebot3_world: a hexagonal ring, five hexagonal blocks and nine pillars, as geometry.

Metres in the world frame (x right, y up, seen from above). Physics and rays are in ``world``; the
map that a robot would have made of it is in ``map``.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

_NUMBERS = ("one", "two", "three")


@dataclass(frozen=True, slots=True)
class Hexagon:
    """An upright hexagonal block; two of its corners lie on the line y = const of its centre."""

    name: str
    x: float  # [m]
    y: float  # [m]
    circumradius: float  # [m]
    z_min: float  # [m]
    z_max: float  # [m]

    @property
    def apothem(self) -> float:
        """Distance of a side from the centre [m]."""
        return self.circumradius * math.sqrt(3.0) / 2.0

    def corners(self) -> Points:
        """Return the corners, counter-clockwise, shape (6, 2) [m]."""
        angles = np.arange(6) * math.pi / 3.0
        circle = np.column_stack([np.cos(angles), np.sin(angles)])
        corners: Points = self.circumradius * circle + (self.x, self.y)
        return corners

    def signed_distance(self, points: Points) -> NDArray[np.float64]:
        """Return how far points of shape (n, 2) are outside; negative inside [m]."""
        # By symmetry every point is seen in the first quadrant, before the nearer of two sides.
        x, y = np.abs(points[:, 0] - self.x), np.abs(points[:, 1] - self.y)
        slope_x, slope_y = math.sqrt(3.0) / 2.0, 0.5
        to_slope = slope_x * x + slope_y * y
        faces_slope = to_slope > y
        out = np.where(faces_slope, to_slope, y) - self.apothem
        along = np.where(faces_slope, np.abs(slope_x * y - slope_y * x), x)
        beyond_corner = np.maximum(along - self.circumradius / 2.0, 0.0)
        distance: NDArray[np.float64] = np.where(
            out > 0.0, np.sqrt(out * out + beyond_corner * beyond_corner), out
        )
        return distance


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright pillar."""

    name: str
    x: float  # [m]
    y: float  # [m]
    radius: float = 0.15  # [m]
    height: float = 0.5  # [m], from the floor

    def signed_distance(self, points: Points) -> NDArray[np.float64]:
        """Return how far points of shape (n, 2) are outside; negative inside [m]."""
        x, y = points[:, 0] - self.x, points[:, 1] - self.y
        distance: NDArray[np.float64] = np.sqrt(x * x + y * y) - self.radius
        return distance


# The meshes are in inches and scaled: a block of circumradius 57.735 in, a ring of 461.88 in.
_INCH = 0.0254
_BLOCK = 57.735 * _INCH
_RING = 461.88 * _INCH * 0.25

RING = Hexagon("body", 0.0, 0.0, _RING, -0.3, 0.97)  # its inside; the wall lies around it
RING_THICKNESS = _RING * 0.125 * math.sqrt(3.0) / 2.0  # the outer circumradius is 9/8 of the inner

BLOCKS: tuple[Hexagon, ...] = (
    Hexagon("head", 3.5, 0.0, 0.8 * _BLOCK, -0.5, 1.532),
    Hexagon("left_hand", 1.8, 2.7, 0.55 * _BLOCK, 0.0, 1.397),
    Hexagon("right_hand", 1.8, -2.7, 0.55 * _BLOCK, 0.0, 1.397),
    Hexagon("left_foot", -1.8, 2.7, 0.55 * _BLOCK, 0.0, 1.397),
    Hexagon("right_foot", -1.8, -2.7, 0.55 * _BLOCK, 0.0, 1.397),
)

CYLINDERS: tuple[Cylinder, ...] = tuple(
    Cylinder(f"{row}_{column}", 1.1 * (i - 1), 1.1 * (j - 1))
    for i, row in enumerate(_NUMBERS)
    for j, column in enumerate(_NUMBERS)
)


def clearance(points: Points) -> NDArray[np.float64]:
    """Return the distance of each point to the nearest surface of the world.

    Parameters
    ----------
    points : ndarray of shape (n, 2)
        In the world frame [m].

    Returns
    -------
    ndarray of shape (n,)
        Positive where a robot could be, negative inside an obstacle and outside the ring [m].
    """
    distances = [-RING.signed_distance(points)]
    distances += [block.signed_distance(points) for block in BLOCKS]
    distances += [cylinder.signed_distance(points) for cylinder in CYLINDERS]
    return functools.reduce(np.minimum, distances)
