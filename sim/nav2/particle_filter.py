"""AMCL's particle filter: poses that move with odometry and are weighted by scans.

The motion model is the differential one, resampling is multinomial with KLD-adapted size, as in
Nav2. Maps and scans come in as a `LikelihoodField`'s weights; the node handles messages.
"""

import math

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats, Ints
from sim.middleware.geometry import Pose2D, wrap_angle

MIN_PARTICLES = 500
MAX_PARTICLES = 2000
BIN = np.array([0.5, 0.5, math.radians(10.0)])  # of the histogram: x, y [m], yaw [rad]
_YAW_BINS = 36
_KLD_ERROR = 0.05
_KLD_Z = 0.99
_ALPHA = 0.2  # alpha1 to alpha4 of the motion model


def kld_limits() -> Ints:
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

    def __init__(self, poses: Floats, rng: np.random.Generator) -> None:
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
        heading_hat = self.poses[:, 2] + (
            first - noise[0] * math.sqrt(_ALPHA * (slip1**2 + translation**2))
        )
        translation_hat = translation - noise[1] * along
        second_hat = second - noise[2] * math.sqrt(_ALPHA * (slip2**2 + translation**2))
        self.poses = np.column_stack(
            [
                self.poses[:, 0] + translation_hat * np.cos(heading_hat),
                self.poses[:, 1] + translation_hat * np.sin(heading_hat),
                heading_hat + second_hat,
            ]
        )

    def weigh(self, factors: Floats) -> None:
        """Multiply the weights by how well a scan fits each particle."""
        weights = self.weights * factors
        self.weights = weights / weights.sum()

    def resample(self) -> None:
        """Resample by weight, to a size that depends on the spread of the samples."""
        cumulative = np.cumsum(self.weights)
        draws = self._rng.random(MAX_PARTICLES) * cumulative[-1]
        _, first, bin_of = _occupied_bins(self.poses)
        self.poses = self.poses[_drawn(cumulative, draws, bin_of, len(first))]
        self.weights = np.full(len(self.poses), 1.0 / len(self.poses))

    def estimate(self) -> tuple[Pose2D, Floats]:
        """Return the mean of the heaviest cluster, and the covariance of all, shape (3, 3).

        As in Nav2 the yaw has its circular variance, and none with x and y.
        """
        labels = cluster_labels(self.poses)
        heaviest = labels == np.argmax(np.bincount(labels, self.weights))
        x, y, yaw = self.poses.T
        vectors = np.array([x, y, np.cos(yaw), np.sin(yaw)])
        mean = _mean(vectors.compress(heaviest, axis=1), self.weights[heaviest]).tolist()
        centre = _mean(vectors, self.weights)
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = _spread(self.poses, self.weights, centre)
        concentration = np.hypot(*(self.weights * vectors[2:]).sum(axis=1))
        covariance[2, 2] = -2.0 * np.log(min(concentration, 1.0))
        return Pose2D(mean[0], mean[1], math.atan2(mean[3], mean[2])), covariance


@jit
def _drawn(cumulative: Floats, draws: Floats, bin_of: Ints, bins: int) -> Ints:
    """Return the particles that draws fall on: as many as their occupied bins need."""
    drawn = np.empty(len(draws), np.int64)
    is_occupied, occupied, count = np.zeros(bins, np.bool_), 0, 0
    while count < _LIMITS[occupied]:
        chosen = np.searchsorted(cumulative, draws[count], side="right")
        chosen = min(chosen, len(cumulative) - 1)
        drawn[count] = chosen
        occupied += not is_occupied[bin_of[chosen]]
        is_occupied[bin_of[chosen]] = True
        count += 1
    return drawn[:count]


@jit
def _spread(poses: Floats, weights: Floats, centre: Floats) -> Floats:
    """Return the covariance of x and y around a centre, shape (2, 2) [m^2].

    Without BLAS, whose sums depend on its threads: the same run gives the same bytes.
    """
    covariance = np.zeros((2, 2))
    for n in range(len(poses)):
        for i in range(2):
            for j in range(2):
                away, other = poses[n, i] - centre[i], poses[n, j] - centre[j]
                covariance[i, j] += weights[n] * away * other
    return covariance


def cluster_labels(poses: Floats) -> Ints:
    """Return a cluster number for each pose: occupied bins that touch, also at a corner, are one.

    Parameters
    ----------
    poses
        Shape (n, 3): x, y [m], yaw [rad].
    """
    bins, first, bin_of = _occupied_bins(poses)
    return _joined(bins[first])[bin_of]


@jit
def _joined(bins: Ints) -> Ints:
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


def _occupied_bins(poses: Floats) -> tuple[Ints, Ints, Ints]:
    """Return the bin of each pose (n, 3), the first pose in each occupied bin, and each one's."""
    bins = _bins(poses)
    keys = (bins[:, 0] * 100_000 + bins[:, 1]) * _YAW_BINS + bins[:, 2]
    _, first, number_of = np.unique(keys, return_index=True, return_inverse=True)
    return bins, first, number_of


@jit
def _bins(poses: Floats) -> Ints:
    """Return the bin of each pose, shape (n, 3)."""
    bins = np.empty(poses.shape, np.int64)
    for i in range(len(poses)):
        for k in range(3):
            bins[i, k] = np.int64(np.floor(poses[i, k] / BIN[k]))
        bins[i, 2] %= _YAW_BINS
    return bins


def _mean(vectors: Floats, weights: Floats) -> Floats:
    """Return the weighted mean of vectors, one a column."""
    mean: Floats = (weights / weights.sum() * vectors).sum(axis=1)
    return mean
