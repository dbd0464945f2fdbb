"""The inflation layer: costs that fall with the distance from obstacles, as Nav2's."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit
from sim.nav2.costmap import FREE_SPACE, INSCRIBED, LETHAL, NO_INFORMATION, Costs

INFLATION_RADIUS = 0.55  # [m]
COST_SCALING = 3.0  # how fast cost falls with distance [1/m]
# Of the global costmap, where it decides how far a path keeps from the middle of a gap.
GLOBAL_COST_SCALING = 10.0


class Inflation(NamedTuple):
    """The parameters of an inflation layer."""

    radius: float = INFLATION_RADIUS  # [m]
    cost_scaling: float = COST_SCALING  # [1/m]


AS_SHIPPED = Inflation()


class InflationLayer:
    """Costs that fall with the distance from obstacles.

    Parameters
    ----------
    resolution
        Edge of a cell [m].
    inscribed_radius
        Distance within which the robot collides whatever its heading [m].
    inflation
        Its radius, and how fast cost falls with distance.
    """

    def __init__(
        self, resolution: float, inscribed_radius: float, inflation: Inflation = AS_SHIPPED
    ) -> None:
        self._reach = round(inflation.radius / resolution)
        cells = np.arange(self._reach + 1)
        rows, columns = (axis.ravel() for axis in np.meshgrid(cells, cells))
        distance = np.hypot(rows, columns) * resolution
        decay = np.exp(-inflation.cost_scaling * (distance - inscribed_radius))
        costs = np.where(distance <= inscribed_radius, INSCRIBED, np.floor((INSCRIBED - 1) * decay))
        squared = rows**2 + columns**2
        near = squared <= self._reach**2
        # By the squared distance [cells]; numbers that are no sum of two squares are never used.
        self._costs = np.full(self._reach**2 + 1, FREE_SPACE, np.uint8)
        self._costs[squared[near]] = costs[near]

    def add_to(self, costs: Costs, lethal: NDArray[np.bool_] | None = None) -> None:
        """Raise ``costs`` around its lethal cells; around some, if the rest has been inflated."""
        _inflate(costs, costs == LETHAL if lethal is None else lethal, self._costs, self._reach)


@jit
def _inflate(costs: Costs, lethal: NDArray[np.bool_], by_square: Costs, reach: int) -> None:
    """Raise each cell to the cost of its distance to the nearest obstacle within reach.

    The squared distance is the least, over the rows within reach, of the squared distance to the
    nearest obstacle of a row. Unknown cells become inscribed within the inscribed radius and stay
    unknown beyond it.
    """
    height, width = costs.shape
    far = np.int16((reach + 1) ** 2)
    beside, has_any = _within_rows(lethal, reach)
    nearest = np.empty(width, np.int16)
    for row in range(height):
        nearest[:] = far
        for other in range(max(0, row - reach), min(height, row + reach + 1)):
            if has_any[other]:
                square, line = np.int16((other - row) ** 2), beside[other]
                for column in range(width):
                    nearest[column] = min(nearest[column], np.int16(line[column] + square))
        for column in range(width):
            if nearest[column] <= reach * reach:
                cost, old = by_square[nearest[column]], costs[row, column]
                if cost > old or (old == NO_INFORMATION and cost == INSCRIBED):
                    costs[row, column] = cost


@jit
def _within_rows(
    lethal: NDArray[np.bool_], reach: int
) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """Return each cell's squared distance to the nearest obstacle of its row, or just out of reach.

    And whether a row has any obstacle; the distances of one that has none are not filled in.
    """
    height, width = lethal.shape
    beside = np.empty((height, width), np.int16)
    has_any = np.zeros(height, np.bool_)
    for row in range(height):
        has_any[row] = np.any(lethal[row])
        if not has_any[row]:
            continue
        gap = reach + 1
        for column in range(width):
            gap = 0 if lethal[row, column] else min(gap + 1, reach + 1)
            beside[row, column] = gap * gap
        gap = reach + 1
        for column in range(width - 1, -1, -1):
            gap = 0 if lethal[row, column] else min(gap + 1, reach + 1)
            beside[row, column] = min(beside[row, column], gap * gap)
    return beside, has_any
