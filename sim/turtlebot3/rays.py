"""Horizontal rays of a LiDAR, and where they hit the world.

The world's pieces are boxes and cylinders, and the intersections are computed as MuJoCo does
(``engine_ray.c``), operation by operation: on a machine whose MuJoCo does not fuse multiplications
and additions, such as x86, ``mj_multiRay`` returns the same bits. It takes six times as long.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats

_MIN = 1e-15  # mjMINVAL
_SPARE = 1e-6  # margin of the test whether a ray comes near a piece [m]


class Geom(NamedTuple):
    """A box or a cylinder, as in ``mjModel`` and ``mjData``."""

    position: Floats  # (3,) of its centre [m]
    rotation: Floats  # (9,) from its frame into the world's, by rows
    size: Floats  # (3,) half sizes of a box; radius and half length of a cylinder [m]
    is_box: bool


class Rays:
    """Casts rays at a set of pieces.

    Parameters
    ----------
    pieces
        What the rays can hit.
    """

    def __init__(self, pieces: Iterable[Geom]) -> None:
        pieces = list(pieces)
        rows = [(*p.position, *p.rotation, *p.size, _reach(p)) for p in pieces]
        self._pieces = np.array(rows, np.float64).reshape(-1, 16)
        self._is_box = np.array([p.is_box for p in pieces], np.bool_)

    def move_last(self, x: float, y: float) -> None:
        """Move the last piece to a place [m]."""
        self._pieces[-1, :2] = x, y

    def distances(
        self, origin: tuple[float, float, float], cosines: Floats, sines: Floats, range_max: float
    ) -> Floats:
        """Return the length of each ray [m]; ``inf`` beyond ``range_max``.

        Parameters
        ----------
        origin
            Of all rays: x, y, z [m].
        cosines, sines
            Shape (n,), of their directions in the plane.
        range_max
            Maximum length [m].
        """
        return _cast(self._pieces, self._is_box, *origin, cosines, sines, range_max)


def _reach(piece: Geom) -> float:
    """Return the radius of a ball around a piece [m]."""
    x, y, z = piece.size
    return math.hypot(x, y, z) if piece.is_box else math.hypot(x, y)


@jit
def _cast(
    pieces: Floats,
    is_box: NDArray[np.bool_],
    x: float,
    y: float,
    z: float,
    cosines: Floats,
    sines: Floats,
    range_max: float,
) -> Floats:
    nearest = np.full(len(cosines), np.inf)
    point = np.empty(3)
    for p in range(len(pieces)):
        position, rotation, size = pieces[p, :3], pieces[p, 3:12], pieces[p, 12:15]
        dx, dy, dz = x - position[0], y - position[1], z - position[2]
        for axis in range(3):
            point[axis] = rotation[axis] * dx + rotation[3 + axis] * dy + rotation[6 + axis] * dz
        reach = pieces[p, 15] + _SPARE
        for i in range(len(cosines)):
            if abs(dx * sines[i] - dy * cosines[i]) > reach:
                continue
            if dx * cosines[i] + dy * sines[i] > reach:  # it points away
                continue
            if is_box[p]:
                distance = _to_box(rotation, size, point, cosines[i], sines[i])
            else:
                distance = _to_cylinder(rotation, size, point, cosines[i], sines[i])
            if 0.0 <= distance < nearest[i]:
                nearest[i] = distance
    for i in range(len(nearest)):
        if nearest[i] > range_max:
            nearest[i] = np.inf
    return nearest


@jit
def _to_box(rotation: Floats, size: Floats, point: Floats, vx: float, vy: float) -> float:
    """Return the distance to a box, -1 if the ray misses it; ``point`` is in the box's frame."""
    ray = (
        rotation[0] * vx + rotation[3] * vy + rotation[6] * 0.0,
        rotation[1] * vx + rotation[4] * vy + rotation[7] * 0.0,
        rotation[2] * vx + rotation[5] * vy + rotation[8] * 0.0,
    )
    best = -1.0
    for axis in range(3):
        if abs(ray[axis]) <= _MIN:
            continue
        j, k = (1, 2) if axis == 0 else (0, 2) if axis == 1 else (0, 1)
        for side in (-1.0, 1.0):
            distance = (side * size[axis] - point[axis]) / ray[axis]
            if (
                distance >= 0.0
                and abs(point[j] + distance * ray[j]) <= size[j]
                and abs(point[k] + distance * ray[k]) <= size[k]
                and (best < 0.0 or distance < best)
            ):
                best = distance
    return best


@jit
def _to_cylinder(rotation: Floats, size: Floats, point: Floats, vx: float, vy: float) -> float:
    """Return the distance to an upright cylinder's round side, -1 if the ray misses it."""
    ray_x = rotation[0] * vx + rotation[3] * vy + rotation[6] * 0.0
    ray_y = rotation[1] * vx + rotation[4] * vy + rotation[7] * 0.0
    # The roots of a x^2 + 2 b x + c.
    a = ray_x * ray_x + ray_y * ray_y
    b = ray_x * point[0] + ray_y * point[1]
    c = point[0] * point[0] + point[1] * point[1] - size[0] * size[0]
    left = b * b - a * c
    if left < 0.0 or a < _MIN or abs(point[2]) > size[1]:
        return -1.0
    root = math.sqrt(left)
    near, far = (-b - root) / a, (-b + root) / a
    return near if near >= 0.0 else far if far >= 0.0 else -1.0
