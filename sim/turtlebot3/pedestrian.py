"""A person who walks to and fro across the robot's way, and turns back before touching it."""

import math
from dataclasses import dataclass

import numpy as np

from sim.middleware.geometry import Pose2D
from sim.turtlebot3.arena import Arena, Cylinder

PERSON = Cylinder("person", 0.0, 0.0, radius=0.2, height=1.7)  # to be moved to its place
_SPEED_M_S = (0.3, 0.8)  # least and most
_STAY_S = (3.0, 10.0)  # at an end, least and most
_REACH_M = 1.5  # from the robot's way to an end of the walk, at most
_NEAREST_M = 0.55  # to ``base_footprint``: the person goes no closer
_DIRECTIONS = 8


@dataclass(frozen=True, slots=True)
class Walk:
    """The straight line between two points of the world on which a person walks."""

    start: tuple[float, float]  # [m]
    end: tuple[float, float]  # [m]
    speed: float  # [m/s]
    stay_s: float  # at both ends


def draw_walk(rng: np.random.Generator, arena: Arena, robot: Pose2D, x: float, y: float) -> Walk:
    """Draw a walk across a place on the robot's way, where the floor is free for longest.

    Parameters
    ----------
    rng
        Draws direction, speed and stay.
    robot : Pose2D
        Its start, in the world frame. The person starts at the end that is farther from it.
    x, y : float
        The place, in the world frame [m].
    """
    turned = rng.uniform(0.0, math.pi / _DIRECTIONS)
    yaws = [turned + i * math.pi / _DIRECTIONS for i in range(_DIRECTIONS)]
    walks = [(_end(arena, x, y, yaw), _end(arena, x, y, yaw + math.pi)) for yaw in yaws]
    longest = max(walks, key=lambda ends: math.dist(*ends))
    end, start = sorted(longest, key=lambda point: math.dist(point, (robot.x, robot.y)))
    return Walk(start, end, rng.uniform(*_SPEED_M_S), rng.uniform(*_STAY_S))


def _end(arena: Arena, x: float, y: float, yaw: float) -> tuple[float, float]:
    """Return the last point before an obstacle, seen from a place in a direction."""
    ahead = np.arange(0.0, _REACH_M, PERSON.radius / 4.0)[:, None]
    points = np.array([x, y]) + ahead * (math.cos(yaw), math.sin(yaw))
    blocked = np.flatnonzero(arena.clearance(points) < PERSON.radius)
    last = len(points) - 1 if not len(blocked) else max(int(blocked[0]) - 1, 0)
    return points[last, 0].item(), points[last, 1].item()


class Pedestrian:
    """The person on a walk.

    Parameters
    ----------
    walk
        From one end to the other and back, until the run ends.
    """

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        self._length = math.dist(walk.start, walk.end)
        self._walked = 0.0  # distance from the start of the walk [m]
        self._direction = -1.0
        self._time_ns = 0
        self._stays_until_ns = 0

    @property
    def position(self) -> tuple[float, float]:
        """Where the person is, in the world frame [m]."""
        return self._at(self._walked)

    def walk_until(self, time_ns: int, robot: Pose2D) -> None:
        """Walk on; stay at an end for a while, and turn back from a robot that is too near."""
        begin_ns = max(self._time_ns, self._stays_until_ns)
        self._time_ns = time_ns
        if time_ns <= begin_ns:
            return
        step = self._direction * self._walk.speed * (time_ns - begin_ns) / 1e9
        there = min(max(self._walked + step, 0.0), self._length)
        if self._is_too_near(there, robot):
            self._direction = -self._direction
            return
        self._walked = there
        if there in (0.0, self._length):
            self._direction = 1.0 if there == 0.0 else -1.0
            self._stays_until_ns = time_ns + round(self._walk.stay_s * 1e9)

    def _is_too_near(self, there: float, robot: Pose2D) -> bool:
        now, then = (math.dist(self._at(s), (robot.x, robot.y)) for s in (self._walked, there))
        return then < _NEAREST_M and then < now

    def _at(self, walked: float) -> tuple[float, float]:
        share = walked / self._length if self._length else 0.0
        (x, y), (end_x, end_y) = self._walk.start, self._walk.end
        return x + share * (end_x - x), y + share * (end_y - y)
