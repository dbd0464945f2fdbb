"""AMCL's likelihood field: how well a laser scan fits a map.

The field depends on the map alone, so it is computed once; weighing a particle takes a look-up and
an addition for each beam.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats

MAX_DISTANCE = 2.0  # to an obstacle; farther counts as this far [m]
SIGMA_HIT = 0.2  # [m]
Z_HIT = 0.5
Z_RAND = 0.5


class LikelihoodField:
    """Scores of beam ends over a map.

    Parameters
    ----------
    occupancy
        Shape (height, width); 100 is an obstacle.
    resolution
        Edge of a cell [m].
    origin_x, origin_y
        Outer corner of cell (0, 0) [m].
    """

    def __init__(
        self, occupancy: NDArray[np.int8], resolution: float, origin_x: float, origin_y: float
    ) -> None:
        if not np.any(occupancy == 100):
            raise ValueError("the map has no occupied cell, so no scan can be matched to it")
        cells = ndimage.distance_transform_edt(occupancy != 100)
        distance = np.minimum(cells * resolution, MAX_DISTANCE)
        hit = Z_HIT * np.exp(-(distance**2) / (2.0 * SIGMA_HIT**2))
        miss = Z_HIT * np.exp(-(MAX_DISTANCE**2) / (2.0 * SIGMA_HIT**2))
        # The cells in the border stand for everything off the map.
        self._hit = np.pad(hit, 1, constant_values=miss)
        self._place = (resolution, origin_x, origin_y)

    def weights(self, poses: Floats, points: Floats, range_max: float) -> Floats:
        """Return how well a scan fits each pose.

        Parameters
        ----------
        poses
            Shape (n, 3): x, y [m] and yaw [rad] of the robot's base in the map.
        points
            Shape (b, 2): where beams ended, in the base frame [m].
        range_max
            Longest range that can be measured [m].

        Returns
        -------
        ndarray of shape (n,)
            One plus the sum over the beams of p cubed, p being the probability density of a hit
            at that distance from the nearest obstacle plus that of a random reading.
        """
        return _weigh(poses, points, self._hit, Z_RAND / range_max, self._place)


@jit
def _weigh(
    poses: Floats, points: Floats, hit: Floats, random: float, place: tuple[float, float, float]
) -> Floats:
    """Weigh by one beam after the other, as processors find the cells of several poses at once."""
    resolution, origin_x, origin_y = place
    height, width = hit.shape
    hit_at, cells = hit.ravel(), np.empty(len(poses), np.int32)
    c, s = np.cos(poses[:, 2]) / resolution, np.sin(poses[:, 2]) / resolution
    x, y = (poses[:, 0] - origin_x) / resolution, (poses[:, 1] - origin_y) / resolution
    weights = np.ones(len(poses))
    for j in range(len(points)):
        ahead, left = points[j]
        for i in range(len(poses)):
            column = np.floor(x[i] + c[i] * ahead - s[i] * left) + 1.0
            row = np.floor(y[i] + s[i] * ahead + c[i] * left) + 1.0
            # Written so that NaN, from a false scan, is in the border.
            column = min(column, width - 1.0) if column > 0.0 else 0.0
            row = min(row, height - 1.0) if row > 0.0 else 0.0
            cells[i] = np.int32(row * width + column)
        for i in range(len(poses)):
            p = random + hit_at[np.uint32(cells[i])]
            weights[i] += p * p * p
    return weights
