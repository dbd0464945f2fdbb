"""Draws arenas: a house with furniture, and random floors of rooms, pillars and clutter.

A piece is placed only where it closes no passage and makes none narrow. So there is no gap through
which the planner leads the robot, and in which the collision monitor stops it.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, ParamSpec

import numpy as np
from scipy import ndimage

from sim.arrays import Floats
from sim.nav2.footprint import INSCRIBED_RADIUS
from sim.turtlebot3.arena import HEXAGON, Arena, ArenaKind, Box, Cylinder, Prism

KINDS: tuple[ArenaKind, ...] = ("hexagon", "house", "random")  # in the order of the rotation

MIN_DOOR_M, MAX_DOOR_M = 1.0, 1.4
MIN_PASSAGE_M = 0.9  # between any two obstacles with a passage between them
_CELL_M = 0.05  # of the grid on which passages are measured
_WALL_HALF_M = 0.06  # half the thickness of a wall between rooms
_BESIDE_DOOR_M = 0.2  # smallest length of wall on both sides of a door
_INTO_WALL_M = 0.02  # furniture at a wall reaches into it: no slot is left
_DRAWS = 20  # attempts to place one piece

_HOUSE = (3.7, 2.8)  # half the length and width of the house [m]
_HOUSE_DOOR_M = 0.96
_MIN_ROOM_M = 2.2
P = ParamSpec("P")
Furnishing = Box | Cylinder

_CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))


class _Room(NamedTuple):
    """A rectangle of floor [m]."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float


def draw_arena(kind: ArenaKind, seed: int) -> Arena:
    """Return the arena of a kind and a seed; there is one hexagon only."""
    if kind == "hexagon":
        return HEXAGON
    return (_house if kind == "house" else _random)(seed, np.random.default_rng(seed))


class _Floor:
    """A floor on which pieces are placed one by one.

    Parameters
    ----------
    half_x, half_y
        Half its length and width [m].
    """

    def __init__(self, half_x: float, half_y: float) -> None:
        self.boundary = Box("walls", 0.0, 0.0, half_x, half_y)
        self.blocks: list[Prism] = []
        self.pillars: list[Cylinder] = []
        axes = (np.arange(-half, half + _CELL_M, _CELL_M) for half in (half_x, half_y))
        self._x, self._y = np.meshgrid(*axes)
        self._points = np.column_stack([self._x.ravel(), self._y.ravel()])
        self._distance = -self.boundary.signed_distance(self._points)
        self._groups = 1  # of obstacles with passages between them

    def put(
        self, draw: Callable[P, Furnishing | list[Box]], *of: P.args, **named: P.kwargs
    ) -> bool:
        """Place a drawn piece, if one of the draws fits; return whether one did."""
        for _ in range(_DRAWS):
            drawn = draw(*of, **named)
            pieces = drawn if isinstance(drawn, list) else [drawn]
            distances = [piece.signed_distance(self._points) for piece in pieces]
            distance = np.minimum.reduce([self._distance, *distances])
            groups = _obstacle_groups(distance.reshape(self._x.shape))
            if groups >= self._groups:  # fewer: it blocks a passage
                self._distance, self._groups = distance, groups
                self.pillars += [piece for piece in pieces if isinstance(piece, Cylinder)]
                self.blocks += [piece for piece in pieces if isinstance(piece, Box)]
                return True
        return False

    def arena(self, kind: ArenaKind, seed: int) -> Arena:
        """Return the pieces on the floor."""
        return Arena(kind, seed, self.boundary, tuple(self.blocks), tuple(self.pillars))


def _obstacle_groups(distance: Floats) -> int:
    """Return the number of groups of obstacles that the robot can drive around; 0 if any is narrow.

    No passage is narrow if growing the obstacles from the robot's radius to half of
    ``MIN_PASSAGE_M`` closes none: the free space stays in one piece, and no two groups meet.

    Parameters
    ----------
    distance
        Of each cell from the nearest surface, shape (rows, columns); negative inside [m].
    """
    groups = set()
    for grown in (INSCRIBED_RADIUS, MIN_PASSAGE_M / 2.0):
        free = np.pad(distance > grown, 1)
        if ndimage.label(free)[1] != 1:
            return 0
        groups.add(int(ndimage.label(~free, np.ones((3, 3)))[1]))
    return groups.pop() if len(groups) == 1 else 0


def _house(seed: int, rng: np.random.Generator) -> Arena:
    """Return four rooms around a loop of doors, as in turtlebot3_house; furniture is drawn."""
    half_x, half_y = _HOUSE
    floor = _Floor(half_x, half_y)
    middle, left, right = -0.1, 0.3, -0.3  # of the walls between the rooms [m]
    plan = [
        *_wall("middle", "y", middle, (-half_y, half_y), (-1.5, 1.7), _HOUSE_DOOR_M),
        *_wall("left", "x", left, (-half_x, middle), (-2.5,), _HOUSE_DOOR_M),
        *_wall("right", "x", right, (middle, half_x), (2.1,), _HOUSE_DOOR_M),
    ]
    floor.put(lambda: plan)
    rooms = (
        _Room(-half_x, -half_y, middle, left),
        _Room(-half_x, left, middle, half_y),
        _Room(middle, -half_y, half_x, right),
        _Room(middle, right, half_x, half_y),
    )
    for i, room in enumerate(rooms):
        for j, (length, depth, height) in enumerate(
            rng.permutation([(1.4, 0.6, 0.5), (1.0, 0.35, 1.6), (0.7, 0.45, 0.8)])[:2].tolist()
        ):
            name = f"furniture_{i}{j}"
            floor.put(_at_a_wall, rng, room, name, length, depth, height)
        floor.put(_free_standing, rng, room, f"table_{i}", (0.3, 0.45), 0.75)
        floor.put(_in_a_corner, rng, room, f"plant_{i}")
    return floor.arena("house", seed)


def _random(seed: int, rng: np.random.Generator) -> Arena:
    """Return a floor of random size, divided into rooms, with pillars and clutter in them."""
    half_x, half_y = rng.uniform(2.7, 3.7), rng.uniform(2.4, 3.0)
    floor = _Floor(half_x, half_y)
    rooms = list(_divided(floor, rng, _Room(-half_x, -half_y, half_x, half_y), depth=2))
    for number in range(rng.integers(2, 6)):
        room = rooms[rng.integers(len(rooms))]
        floor.put(_pillar, rng, room, f"pillar_{number}")
    for number in range(rng.integers(3, 8)):
        room, height = rooms[rng.integers(len(rooms))], rng.uniform(0.3, 1.2)
        floor.put(_free_standing, rng, room, f"clutter_{number}", (0.12, 0.4), height)
    return floor.arena("random", seed)


def _divided(floor: _Floor, rng: np.random.Generator, room: _Room, depth: int) -> Iterator[_Room]:
    """Divide a room by walls, each with a door; yield the resulting rooms."""
    size = (room.x_max - room.x_min, room.y_max - room.y_min)
    along = "y" if size[0] > size[1] else "x"  # the wall crosses the longer side
    low, high = (room.x_min, room.x_max) if along == "y" else (room.y_min, room.y_max)
    ends = (room.y_min, room.y_max) if along == "y" else (room.x_min, room.x_max)
    if depth == 0 or high - low < 2.0 * _MIN_ROOM_M:
        yield room
        return
    at = 0.0

    def wall() -> list[Box]:
        nonlocal at
        at = rng.uniform(low + _MIN_ROOM_M, high - _MIN_ROOM_M)
        width = rng.uniform(MIN_DOOR_M, MAX_DOOR_M)
        beside = width / 2.0 + _BESIDE_DOOR_M
        door = rng.uniform(ends[0] + beside, ends[1] - beside)
        return _wall(f"wall_{len(floor.blocks)}", along, at, ends, (door,), width)

    if not floor.put(wall):
        yield room
        return
    for part in (
        room._replace(x_max=at) if along == "y" else room._replace(y_max=at),
        room._replace(x_min=at) if along == "y" else room._replace(y_min=at),
    ):
        yield from _divided(floor, rng, part, depth - 1)


def _wall(
    name: str,
    along: str,
    at: float,
    ends: tuple[float, float],
    doors: tuple[float, ...],
    width: float,
) -> list[Box]:
    """Return the parts of a wall along an axis between its doors."""
    edges = [ends[0], *(door + side * width / 2.0 for door in doors for side in (-1, 1)), ends[1]]
    parts = []
    for number, (begin, end) in enumerate(zip(edges[::2], edges[1::2], strict=True)):
        middle, half = (begin + end) / 2.0, (end - begin) / 2.0
        place = (
            (at, middle, _WALL_HALF_M, half) if along == "y" else (middle, at, half, _WALL_HALF_M)
        )
        parts.append(Box(f"{name}_{number}", *place))
    return parts


def _at_a_wall(
    rng: np.random.Generator, room: _Room, name: str, length: float, depth: float, height: float
) -> Box:
    """Return a piece of furniture with its back in one of a room's walls."""
    side, share = int(rng.integers(4)), rng.uniform()
    into = depth / 2.0 + _WALL_HALF_M - _INTO_WALL_M
    half = (length / 2.0, depth / 2.0) if side < 2 else (depth / 2.0, length / 2.0)
    x = room.x_min + half[0] + share * (room.x_max - room.x_min - 2.0 * half[0])
    y = room.y_min + half[1] + share * (room.y_max - room.y_min - 2.0 * half[1])
    if side < 2:
        y = (room.y_min + into, room.y_max - into)[side]
    else:
        x = (room.x_min + into, room.x_max - into)[side - 2]
    return Box(name, x, y, *half, height=height)


def _free_standing(
    rng: np.random.Generator, room: _Room, name: str, half: tuple[float, float], height: float
) -> Box:
    """Return a box somewhere in a room, turned by any angle."""
    x, y = rng.uniform(room[:2], room[2:]).tolist()
    half_x, half_y = rng.uniform(*half, 2).tolist()
    return Box(name, x, y, half_x, half_y, rng.uniform(-math.pi, math.pi), height)


def _in_a_corner(rng: np.random.Generator, room: _Room, name: str) -> Cylinder:
    i, j = _CORNERS[rng.integers(4)]
    into = 0.2
    x = room.x_min + into if i < 0 else room.x_max - into
    y = room.y_min + into if j < 0 else room.y_max - into
    return Cylinder(name, x, y, rng.uniform(0.12, 0.2))


def _pillar(rng: np.random.Generator, room: _Room, name: str) -> Cylinder:
    x, y = rng.uniform(room[:2], room[2:]).tolist()
    return Cylinder(name, x, y, rng.uniform(0.1, 0.25), 1.0)
