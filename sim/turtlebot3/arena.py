"""Arenas as geometry, of which turtlebot3_world is the first.

Coordinates are metres in the world frame (x right, y up, seen from above). ``floor_plans`` draws
further arenas, ``world`` has physics and rays, and ``map`` the map that SLAM would have made.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

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

    def signed_distance(self, points: Points) -> NDArray[np.float64]:
        """Return the distance of points of shape (n, 2) from the surface; negative inside [m]."""
        # By symmetry, every point is moved to the first quadrant, in front of the nearer of two
        # sides.
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

    def signed_distance(self, points: Points) -> NDArray[np.float64]:
        """Return the distance of points of shape (n, 2) from the surface; negative inside [m]."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y = points[:, 0] - self.x, points[:, 1] - self.y
        along, across = np.abs(c * x + s * y) - self.half_x, np.abs(c * y - s * x) - self.half_y
        beyond = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
        distance: NDArray[np.float64] = beyond + np.minimum(np.maximum(along, across), 0.0)
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
        """Return the distance of points of shape (n, 2) from the surface; negative inside [m]."""
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


Block: TypeAlias = Hexagon | Box


@dataclass(frozen=True, slots=True)
class Arena:
    """The boundary and the obstacles that a robot drives among; obstacles may be missing."""

    kind: ArenaKind
    seed: int  # seed that it was drawn from; 0 if nothing is drawn
    boundary: Block  # inner face of the outer wall
    blocks: tuple[Block, ...]
    pillars: tuple[Cylinder, ...]

    @property
    def id(self) -> str:
        """Kind and seed, which identify an arena that is not mirrored."""
        return f"{self.kind}-{self.seed}"

    def clearance(self, points: Points) -> NDArray[np.float64]:
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
        distances = [-self.boundary.signed_distance(points)]
        distances += [block.signed_distance(points) for block in self.blocks]
        distances += [pillar.signed_distance(points) for pillar in self.pillars]
        return functools.reduce(np.minimum, distances)

    def mirrored(self) -> Self:
        """Return the arena as seen in a mirror along the x axis."""
        return replace(
            self,
            boundary=_mirrored(self.boundary),
            blocks=tuple(map(_mirrored, self.blocks)),
            pillars=tuple(replace(pillar, y=0.0 - pillar.y) for pillar in self.pillars),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the arena as JSON values."""
        blocks, pillars = map(asdict, self.blocks), map(asdict, self.pillars)
        return {**asdict(self), "blocks": list(blocks), "pillars": list(pillars)}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the arena from the result of ``to_dict``."""
        return cls(
            **{
                **document,
                "boundary": _block(document["boundary"]),
                "blocks": tuple(map(_block, document["blocks"])),
                "pillars": tuple(Cylinder(**pillar) for pillar in document["pillars"]),
            }
        )


def _mirrored(block: Block) -> Block:
    if isinstance(block, Box):
        return replace(block, y=0.0 - block.y, yaw=0.0 - block.yaw)
    return replace(block, y=0.0 - block.y)  # its corners lie alike on both sides


def _block(document: Mapping[str, Any]) -> Block:
    return Hexagon(**document) if "circumradius" in document else Box(**document)


HEXAGON = Arena("hexagon", 0, RING, BLOCKS, CYLINDERS)
