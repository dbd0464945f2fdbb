"""The true path and distance of the robot, for the manifest; no node has access to it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.middleware.executor import MILLISECOND, Executor
from sim.middleware.geometry import Pose2D

_PERIOD_NS = 100 * MILLISECOND  # a tenth of a second at 0.26 m/s is 3 cm of a smooth arc


class Odometer:
    """Records the path of the robot, and sums up its length in parts.

    Parameters
    ----------
    executor
        Its clock.
    pose
        Ground truth of the robot.
    """

    def __init__(self, executor: Executor, pose: Callable[[], Pose2D]) -> None:
        self._executor = executor
        self._pose = pose
        self._last = pose()
        self._places: list[tuple[float, float]] = []
        self._total_m = 0.0
        self._marks: list[float] = []
        self._measure()

    def mark(self) -> None:
        """Begin a new part of the path."""
        self._marks.append(self._total_m)

    def distances(self) -> list[float]:
        """Return the length of each part so far [m]."""
        ends = [*self._marks[1:], self._total_m]
        return [end - begin for begin, end in zip(self._marks, ends, strict=True)]

    def places(self) -> NDArray[np.float64]:
        """Return the positions since the first part began, shape (n, 2) [m]."""
        return np.array(self._places).reshape(-1, 2)

    def _measure(self) -> None:
        here = self._pose()
        if self._marks:
            self._places.append((here.x, here.y))
        self._total_m += here.distance_to(self._last)
        self._last = here
        self._executor.call_at(self._executor.now_ns + _PERIOD_NS, self._measure)
