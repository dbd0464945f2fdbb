"""AMCL's particle filter: poses that move with odometry and are weighted by scans.

The motion model is the differential one, resampling is multinomial with KLD-adapted size, as in
Nav2. Maps and scans come in as a `LikelihoodField`'s weights; the node handles messages.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit
from sim.middleware.geometry import Pose2D, wrap_angle

MIN_PARTICLES = 500
MAX_PARTICLES = 2000
BIN = np.array([0.5, 0.5, math.radians(10.0)])  # of the histogram: x, y [m], yaw [rad]
_YAW_BINS = 36
_MANY_BINS = 1_000_000  # in the box around all particles: too many to count through
_KLD_ERROR = 0.05
_KLD_Z = 0.99
_ALPHA = 0.2  # alpha1 to alpha4 of the motion model


def kld_limits() -> NDArray[np.int64]:
    """Return how many particles are enough for k occupied bins, by k from 0 to the maximum.

    With one bin or none, the result is the maximum. So a filter that has converged to one bin does
    not shrink, as in AMCL.
    """
    k = np.arange(2, MAX_PARTICLES + 1)
    b = 2.0 / (9.0 * (k - 1))
    n = np.ceil((k - 1) / (2.0 * _KLD_ERROR) * (1.0 - b + np.sqrt(b) * _KLD_Z) ** 3)
    enough = np.clip(n, MIN_PARTICLES, MAX_PARTICLES).astype(np.int64)
    return np.concatenate([[MAX_PARTICLES, MAX_PARTICLES], enough])


_LIMITS = kld_limits()


class ParticleFilter:
    """A belief about the robot's pose.

    Parameters
    ----------
    poses
        Shape (n, 3), equally likely: x, y [m], yaw [rad] of the robot's base in the map.
    rng
        The only source of randomness.

    Attributes
    ----------
    poses
        Shape (n, 3), as above, after the latest step.
    weights
        Shape (n,), sum one.
    """

    def __init__(self, poses: NDArray[np.float64], rng: np.random.Generator) -> None:
        self._rng = rng
        self.poses = poses
        self.weights = np.full(len(poses), 1.0 / len(poses))

    def move(self, before: Pose2D, after: Pose2D) -> None:
        """Move every particle by the odometry, each with independent noise.

        Parameters
        ----------
        before, after
            The robot in the odometry frame.
        """
        translation = before.distance_to(after)
        turn = wrap_angle(after.yaw - before.yaw)
        heading = math.atan2(after.y - before.y, after.x - before.x)
        # Without translation, the direction of travel is noise.
        first = wrap_angle(heading - before.yaw) if translation >= 0.01 else 0.0
        second = wrap_angle(turn - first)
        # Driving backwards does not count as a turn by pi.
        slip1, slip2 = (min(abs(a), math.pi - abs(a)) for a in (first, second))
        along = math.sqrt(_ALPHA * (translation**2 + slip1**2 + slip2**2))
        noise = self._rng.standard_normal((3, len(self.poses)))
        first_hat = first - noise[0] * math.sqrt(_ALPHA * (slip1**2 + translation**2))
        translation_hat = translation - noise[1] * along
        second_hat = second - noise[2] * math.sqrt(_ALPHA * (slip2**2 + translation**2))
        x, y, yaw = self.poses.T
        self.poses = np.column_stack(
            [
                x + translation_hat * np.cos(yaw + first_hat),
                y + translation_hat * np.sin(yaw + first_hat),
                yaw + first_hat + second_hat,
            ]
        )

    def weigh(self, factors: NDArray[np.float64]) -> None:
        """Multiply the weights by how well a scan fits each particle."""
        weights = self.weights * factors
        self.weights = weights / weights.sum()

    def resample(self) -> None:
        """Resample by weight, to a size that depends on the spread of the samples."""
        cumulative = np.cumsum(self.weights)
        draws = self._rng.random(MAX_PARTICLES) * cumulative[-1]
        chosen = np.searchsorted(cumulative, draws, side="right")
        drawn = self.poses[np.minimum(chosen, len(self.poses) - 1)]
        _, first, _ = _occupied_bins(drawn)
        is_new = np.zeros(MAX_PARTICLES, dtype=np.int64)
        is_new[first] = 1
        enough = np.arange(1, MAX_PARTICLES + 1) >= _LIMITS[np.cumsum(is_new)]
        count = int(np.argmax(enough)) + 1
        self.poses = drawn[:count]
        self.weights = np.full(count, 1.0 / count)

    def estimate(self) -> tuple[Pose2D, NDArray[np.float64]]:
        """Return the mean of the heaviest cluster, and the covariance of all, shape (3, 3).

        As in Nav2 the yaw has its circular variance, and none with x and y.
        """
        labels = cluster_labels(self.poses)
        heaviest = labels == np.argmax(np.bincount(labels, self.weights))
        mean = _mean(self.poses[heaviest], self.weights[heaviest])
        away = (self.poses - _mean(self.poses, self.weights))[:, :2]
        covariance = np.zeros((3, 3))
        # Without BLAS, whose sums depend on its threads: the same run gives the same bytes.
        covariance[:2, :2] = np.einsum("n,ni,nj->ij", self.weights, away, away)
        yaw = self.poses[:, 2]
        concentration = np.hypot(*(np.sum(self.weights * f(yaw)) for f in (np.cos, np.sin)))
        covariance[2, 2] = -2.0 * np.log(min(concentration, 1.0))
        return Pose2D(*mean.tolist()), covariance


def cluster_labels(poses: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a cluster number for each pose: occupied bins that touch, also at a corner, are one.

    Parameters
    ----------
    poses
        Shape (n, 3): x, y [m], yaw [rad].
    """
    bins, first, bin_of = _occupied_bins(poses)
    return _joined(bins[first])[bin_of]


@jit
def _joined(bins: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a cluster number for each of some different bins, shape (k, 3).

    Clusters are numbered by their first bins.
    """
    cluster = np.full(len(bins), -1, np.int64)
    reached = np.empty(
        len(bins), np.int64
    )  # bins of the current cluster whose neighbours are still to be visited
    count = 0
    for first in range(len(bins)):
        if cluster[first] >= 0:
            continue
        cluster[first], reached[0], size, at = count, first, 1, 0
        while at < size:
            here = bins[reached[at]]
            at += 1
            for other in range(first + 1, len(bins)):
                if cluster[other] >= 0:
                    continue
                turn = abs(bins[other, 2] - here[2])
                if (
                    abs(bins[other, 0] - here[0]) <= 1
                    and abs(bins[other, 1] - here[1]) <= 1
                    and min(turn, _YAW_BINS - turn) <= 1
                ):
                    cluster[other], reached[size] = count, other
                    size += 1
        count += 1
    return cluster


def _occupied_bins(
    poses: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the bin of each pose (n, 3), the first pose in each occupied bin, and each one's."""
    bins = np.floor(poses / BIN).astype(np.int64)
    bins[:, 2] %= _YAW_BINS
    x, y = _extent(bins)
    if (x + 1.0) * (y + 1.0) * _YAW_BINS > _MANY_BINS:  # odometry that jumps scatters them
        keys = (bins[:, 0] * 100_000 + bins[:, 1]) * _YAW_BINS + bins[:, 2]
        _, first, number_of = np.unique(keys, return_index=True, return_inverse=True)
        return bins, first, number_of
    return bins, *_numbered(bins)


@jit
def _extent(bins: NDArray[np.int64]) -> tuple[float, float]:
    """Return the extent of bins in x and y, in doubles, which hold any distance."""
    x, y = bins[:, 0], bins[:, 1]
    return float(x.max()) - float(x.min()), float(y.max()) - float(y.min())


@jit
def _numbered(bins: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first index of each bin, bins in ascending order, and the number of each row's.

    As ``np.unique`` with ``return_index`` and ``return_inverse``, for bins that lie near each
    other: it counts through all bins of the box around them.
    """
    low_x, low_y = bins[:, 0].min(), bins[:, 1].min()
    width, depth = bins[:, 1].max() - low_y + 1, _YAW_BINS
    cells = ((bins[:, 0] - low_x) * width + bins[:, 1] - low_y) * depth + bins[:, 2]
    number = np.full(cells.max() + 1, -1, np.int64)
    for cell in cells:
        number[cell] = 0
    count = 0
    for cell in range(len(number)):
        if number[cell] == 0:
            number[cell] = count
            count += 1
    first, number_of = np.full(count, -1, np.int64), np.empty(len(cells), np.int64)
    for i in range(len(cells)):
        number_of[i] = number[cells[i]]
        if first[number_of[i]] < 0:
            first[number_of[i]] = i
    return first, number_of


def _mean(poses: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    share = weights / weights.sum()
    x, y, yaw = poses.T
    direction = math.atan2(np.sum(share * np.sin(yaw)), np.sum(share * np.cos(yaw)))
    return np.array([np.sum(share * x), np.sum(share * y), direction])
