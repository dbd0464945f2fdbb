"""Arenas as geometry, of which turtlebot3_world is the first.

Coordinates are metres in the world frame (x right, y up, seen from above). ``floor_plans`` draws
further arenas, ``world`` has physics and rays, and ``map`` the map that SLAM would have made.
"""

import functools
import math
from dataclasses import dataclass, replace
from typing import Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats

Points = NDArray[np.float64]
ArenaKind = Literal["hexagon", "house", "random"]

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

    @property
    def reach(self) -> tuple[float, float]:
        """Extent from its centre along x and along y [m]."""
        return self.circumradius, self.apothem

    def slabs(self) -> Points:
        """Return the strips whose intersection it is, as `Box.slabs` does."""
        angles = (math.pi / 6, math.pi / 2, 5 * math.pi / 6)
        return np.array([(math.cos(a), math.sin(a), self.apothem) for a in angles])

    def corners(self) -> Points:
        """Return the corners, counter-clockwise, shape (6, 2) [m]."""
        angles = np.arange(6) * math.pi / 3.0
        circle = np.column_stack([np.cos(angles), np.sin(angles)])
        corners: Points = self.circumradius * circle + (self.x, self.y)
        return corners

    def outline(self) -> "Outline":
        """Return the outline seen from above."""
        return _HEXAGON, self.x, self.y, self.apothem, self.circumradius / 2.0, 1.0, 0.0

    def signed_distance(self, points: Points) -> Floats:
        """Return the distance of points of shape (n, 2) from the surface; negative inside [m]."""
        return _distances(points, np.array(self.outline()))


@dataclass(frozen=True, slots=True)
class Box:
    """An upright cuboid that stands on the floor."""

    name: str
    x: float  # of its centre [m]
    y: float  # [m]
    half_x: float  # half its length along its own x axis [m]
    half_y: float  # [m]
    yaw: float = 0.0  # counter-clockwise [rad]
    height: float = 1.0  # [m]

    @property
    def reach(self) -> tuple[float, float]:
        """Extent from its centre along x and along y [m]."""
        c, s = abs(math.cos(self.yaw)), abs(math.sin(self.yaw))
        return c * self.half_x + s * self.half_y, s * self.half_x + c * self.half_y

    def slabs(self) -> Points:
        """Return the strips whose intersection it is, shape (3, 3).

        Each has the x and y of its unit normal and half its width [m]; the last one is everywhere.
        """
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([(c, s, self.half_x), (-s, c, self.half_y), (0.0, 0.0, math.inf)])

    def outline(self) -> "Outline":
        """Return the outline seen from above."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return _RECTANGLE, self.x, self.y, self.half_x, self.half_y, c, s

    def signed_distance(self, points: Points) -> Floats:
        """Return the distance of points of shape (n, 2) from the surface; negative inside [m]."""
        return _distances(points, np.array(self.outline()))


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright pillar."""

    name: str
    x: float  # [m]
    y: float  # [m]
    radius: float = 0.15  # [m]
    height: float = 0.5  # [m], from the floor

    def outline(self) -> "Outline":
        """Return the outline seen from above."""
        return _CIRCLE, self.x, self.y, self.radius, 0.0, 1.0, 0.0

    def signed_distance(self, points: Points) -> Floats:
        """Return the distance of points of shape (n, 2) from the surface; negative inside [m]."""
        return _distances(points, np.array(self.outline()))


# Kind, centre [m], two lengths [m], and cosine and sine of the yaw: what distances depend on.
Outline: TypeAlias = tuple[float, float, float, float, float, float, float]
_CIRCLE, _RECTANGLE, _HEXAGON = 0.0, 1.0, 2.0


@jit
def _distance(outline: Floats, x: float, y: float) -> float:
    """Return the distance of a point from an outline; negative inside [m]."""
    kind, centre_x, centre_y, first, second, c, s = outline
    x, y = x - centre_x, y - centre_y
    if kind == _CIRCLE:
        return float(math.sqrt(x * x + y * y) - first)
    if kind == _RECTANGLE:
        along, across = abs(c * x + s * y) - first, abs(c * y - s * x) - second
        beyond = math.hypot(max(along, 0.0), max(across, 0.0))
        return float(beyond + min(max(along, across), 0.0))
    # By symmetry, the point is moved to the first quadrant, in front of the nearer of two sides.
    x, y = abs(x), abs(y)
    slope_x, slope_y = math.sqrt(3.0) / 2.0, 0.5
    out, along = slope_x * x + slope_y * y, abs(slope_x * y - slope_y * x)
    if out <= y:
        out, along = y, x
    out -= first
    beyond_corner = max(along - second, 0.0)
    return math.sqrt(out * out + beyond_corner * beyond_corner) if out > 0.0 else out


@jit
def _distances(points: Points, outline: Floats) -> Floats:
    found = np.empty(len(points))
    for i in range(len(points)):
        found[i] = _distance(outline, points[i, 0], points[i, 1])
    return found


@jit
def _clearance(points: Points, boundary: Floats, obstacles: Floats) -> Floats:
    found = np.empty(len(points))
    for i in range(len(points)):
        nearest = -_distance(boundary, points[i, 0], points[i, 1])
        for j in range(len(obstacles)):
            nearest = min(nearest, _distance(obstacles[j], points[i, 0], points[i, 1]))
        found[i] = nearest
    return found


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


Prism: TypeAlias = Hexagon | Box


@dataclass(frozen=True, slots=True)
class Arena:
    """The boundary and the obstacles that a robot drives among; obstacles may be missing."""

    kind: ArenaKind
    seed: int  # seed that it was drawn from; 0 if nothing is drawn
    boundary: Prism  # inner face of the outer wall
    blocks: tuple[Prism, ...]
    pillars: tuple[Cylinder, ...]

    @property
    def id(self) -> str:
        """Kind and seed, which identify an arena that is not mirrored."""
        return f"{self.kind}-{self.seed}"

    def clearance(self, points: Points) -> Floats:
        """Return the distance of each point to the nearest surface.

        Parameters
        ----------
        points : ndarray of shape (n, 2)
            In the world frame [m].

        Returns
        -------
        ndarray of shape (n,)
            Positive where a robot could be, negative inside an obstacle and outside the wall [m].
        """
        return _clearance(points, *_outlines(self))

    def mirrored(self) -> Self:
        """Return the arena as seen in a mirror along the x axis."""
        return replace(
            self,
            boundary=_mirrored(self.boundary),
            blocks=tuple(map(_mirrored, self.blocks)),
            pillars=tuple(replace(pillar, y=0.0 - pillar.y) for pillar in self.pillars),
        )


@functools.lru_cache(maxsize=8)  # many points are drawn in the same arena
def _outlines(arena: Arena) -> tuple[Floats, Floats]:
    """Return the outline of the boundary, and those of the obstacles, one in a row."""
    obstacles = [piece.outline() for piece in (*arena.blocks, *arena.pillars)]
    return np.array(arena.boundary.outline()), np.array(obstacles).reshape(-1, 7)


def _mirrored(block: Prism) -> Prism:
    if isinstance(block, Box):
        return replace(block, y=0.0 - block.y, yaw=0.0 - block.yaw)
    return replace(block, y=0.0 - block.y)  # its corners lie alike on both sides


HEXAGON = Arena("hexagon", 0, RING, BLOCKS, CYLINDERS)
