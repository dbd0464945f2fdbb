"""The inflation layer: costs that fall with the distance from obstacles, as Nav2's."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from sim.nav2.costmap import FREE_SPACE, INSCRIBED, LETHAL, NO_INFORMATION, Costs

INFLATION_RADIUS = 0.55  # [m]
COST_SCALING = 3.0  # how fast cost falls with distance [1/m]
# Of the global costmap, where it decides how far a path keeps from the middle of a gap.
GLOBAL_COST_SCALING = 10.0
_LANES = 16  # numbers of 16 bits that a processor adds at once


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
        self._costs = np.full((self._reach + 1) ** 2 + 1, FREE_SPACE, np.uint8)
        self._costs[squared[near]] = costs[near]

    def add_to(self, costs: Costs) -> None:
        """Raise ``costs`` around its lethal cells."""
        _inflate(costs, self._costs, self._reach)


@jit
def _inflate(costs: Costs, by_square: Costs, reach: int) -> None:
    """Raise each cell to the cost of its distance to the nearest obstacle within reach.

    The squared distance is the least, over the columns within reach, of the squared distance to
    the nearest obstacle of a column. Unknown cells become inscribed within the inscribed radius
    and stay unknown beyond it.
    """
    height, width = costs.shape
    squares, is_near = _within_columns(costs, reach)
    size = squares.shape[1] - 2 * reach
    for row in range(height):
        if not is_near[row]:
            continue
        nearest = squares[row, reach : reach + size].copy()
        for offset in range(1, reach + 1):
            square = np.int16(offset**2)
            left = squares[row, reach - offset : reach - offset + size]
            right = squares[row, reach + offset : reach + offset + size]
            for column in range(size):
                beside = np.int16(min(left[column], right[column]) + square)
                nearest[column] = min(nearest[column], beside)
        for column in range(width):
            cost, old = by_square[nearest[column]], costs[row, column]
            is_raised = (cost > old) | ((old == NO_INFORMATION) & (cost == INSCRIBED))
            costs[row, column] = cost if is_raised else old


@jit
def _within_columns(costs: Costs, reach: int) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """Return each cell's squared distance to the nearest obstacle of its column [cells].

    Farther ones count as just out of reach, and so do the columns added on both sides: as many as
    are within reach, and on the right up to a multiple of what one instruction adds. And whether
    any distance of a row is within reach.
    """
    height, width = costs.shape
    far = np.int16(reach + 1)
    squares = np.full((height, -_LANES * (-width // _LANES) + 2 * reach), far * far, np.int16)
    gap = np.full(width, far, np.int16)  # to the nearest obstacle above, then below
    for row in range(height):
        line = squares[row, reach : reach + width]
        for column in range(width):
            is_lethal = costs[row, column] == LETHAL
            gap[column] = np.int16(0) if is_lethal else min(np.int16(gap[column] + 1), far)
            line[column] = gap[column]
    gap[:] = far
    is_near = np.zeros(height, np.bool_)
    for row in range(height - 1, -1, -1):
        line = squares[row, reach : reach + width]
        least = far
        for column in range(width):
            gap[column] = min(np.int16(gap[column] + 1), line[column])
            line[column] = gap[column] * gap[column]
            least = min(least, gap[column])
        is_near[row] = least < far
    return squares, is_near
