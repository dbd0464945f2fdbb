"""Distance of a run in the group of columns where it is most unusual.

With hundreds of columns and ten runs, a change of one signal is lost in the distance over all of
them. Its topic has few columns, so there it stands out.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from oracle_pipeline.clustering.scaling import CLIP, ROUNDING_FLOOR, FlooredRobustScaler
from oracle_pipeline.detectors.base import OwnDetector, shrinkage

Floats = NDArray[np.float64]
LEAST_DIRECTIONS = 12  # of a group whose variances are kept
LEAST_SHARE = 0.5  # of the standard deviation: smallest scale
OF_CONSTANT = 5.0  # scales that a change of a constant counts for
OF_OWN = {  # least scales of statistics, in the usual one of a signal
    "mean": ("std", 0.005), "std": ("std", 0.005), "min": ("std", 0.005), "max": ("std", 0.005),
    "change": ("change", 0.05),
}  # fmt: skip
OF_PERIODS = {  # the same, of the time between messages
    "mean": ("mean", 0.5), "std": ("mean", 2.0), "min": ("mean", 2.0), "max": ("mean", 10.0),
    "change": ("mean", 1.0),
}  # fmt: skip
OF_SEQUENCE_OF_PERIODS = 10.0  # least scale of statistics without a unit
_ROUNDING = 1e-12  # of all variance; one direction with less has none
_LEAST_NOISE = 0.05  # variance in any other direction; rows are z-scores
_LEAST_TYPICAL = 1.0  # distance that a group without variance is compared with


class SignalScaler(FlooredRobustScaler):
    """Scale statistics of signals, of which there are hundreds, and few recordings.

    The scale is at least half of the standard deviation, since MAD is 0 for a column that few
    recordings change. A column that most do not change has no scale that can be trusted: any change
    of it counts as at most `OF_CONSTANT` scales, because among hundreds of such columns one changes
    by chance. A signal that changes in every recording does not stand still by chance.

    Each statistic has a least scale, relative to what its signal usually does in a recording: what
    a queue or another machine does to messages is no other behaviour, though a simulator sends them
    to the nanosecond.

    Attributes
    ----------
    is_constant_ : ndarray of bool, shape (len(kept_),)
    """

    of_zero = 1e-6  # above rounding errors, and below any change that means something

    def _adjust(self, mad: Floats, deviation: Floats) -> None:
        self.indicated_ = []
        steady = np.minimum(mad, deviation) <= ROUNDING_FLOOR * np.abs(self.center_)
        usual = dict(zip(self.kept_, self.center_.tolist(), strict=True))
        self.is_constant_ = steady & ~_can_stand_still(usual)
        self.scale_ = np.maximum.reduce(
            [self.scale_, LEAST_SHARE * deviation, _least_scales(usual)]
        )

    def _limits(self) -> Floats:
        return np.where(self.is_constant_, OF_CONSTANT, CLIP)


def _least_scales(usual: Mapping[str, float]) -> Floats:
    """Return the least scale of each column, in its unit, from the usual value of all."""
    least = np.zeros(len(usual))
    for number, column in enumerate(usual):
        signal, _, statistic = column.rpartition(".")
        is_period = signal.endswith("/period")
        if found := (OF_PERIODS if is_period else OF_OWN).get(statistic):
            of, share = found
            least[number] = share * abs(usual.get(f"{signal}.{of}", 0.0))
        elif is_period:
            least[number] = OF_SEQUENCE_OF_PERIODS
    return least


def _can_stand_still(usual: Mapping[str, float]) -> NDArray[np.bool_]:
    """Return a mask of the longest standstill of signals that usually change."""
    spreads = [f"{c.removesuffix('held')}std" if c.endswith(".held") else "" for c in usual]
    return np.array([usual.get(spread, 0.0) > 0.0 for spread in spreads])


class LargestGroup(OwnDetector):
    """The largest distance over groups of columns, each in units of a typical normal one.

    The distance is Mahalanobis's in a covariance that is shrunk after Ledoit and Wolf, of which the
    largest directions are kept; it needs no more rows than columns.

    Parameters
    ----------
    groups : sequence of str, optional
        Group of each column; by default all are one group.
    directions : int
        Directions of a group that are kept, at least `LEAST_DIRECTIONS`.

    Attributes
    ----------
    location_ : ndarray of shape (n_features,)
    components_, variances_ : list of ndarray, shape (k, n_columns) and (k,)
        Directions of each group, and the shrunk variances in them.
    noise_, typical_ : ndarray of shape (n_groups,)
        Variance in all other directions, and median distance of the fitted rows.
    """

    def __init__(self, groups: Sequence[str] | None = None, directions: int = 0) -> None:
        self.groups = groups
        self.directions = directions

    def _learn(self, X: Floats) -> None:
        self.location_ = X.mean(axis=0)
        centred, groups = X - self.location_, self._columns(X.shape[1])
        found = [_shrunk(centred[:, columns], self.directions) for columns in groups]
        self.components_, self.variances_, noise = map(list, zip(*found, strict=True))
        self.noise_ = np.array(noise)
        self.typical_ = np.ones(len(found))
        self.typical_ = np.maximum(np.median(self._by_group(X), axis=0), _LEAST_TYPICAL)

    def _distance(self, X: Floats) -> Floats:
        return np.asarray(self._by_group(X).max(axis=1), dtype=np.float64)

    def _by_group(self, X: Floats) -> Floats:
        """Return the distance of each row in each group, shape (n_rows, n_groups)."""
        squared = []
        for columns, components, variances, noise in zip(
            self._columns(X.shape[1]), self.components_, self.variances_, self.noise_, strict=True
        ):
            deviation = X[:, columns] - self.location_[columns]
            along = (deviation @ components.T) ** 2
            beside = np.maximum((deviation**2).sum(axis=1) - along.sum(axis=1), 0.0)
            squared.append(beside / noise + (along / variances).sum(axis=1))
        return np.asarray(np.sqrt(np.column_stack(squared)) / self.typical_, dtype=np.float64)

    def sizes(self, n_features: int) -> list[int]:
        """Return the number of columns of each group."""
        return [len(columns) for columns in self._columns(n_features)]

    def _columns(self, n_features: int) -> list[NDArray[np.intp]]:
        if self.groups is None:
            return [np.arange(n_features)]
        groups = np.asarray(self.groups)
        return [np.flatnonzero(groups == name) for name in np.unique(groups)]


def _shrunk(centred: Floats, most: int) -> tuple[Floats, Floats, float]:
    """Return directions, the variances in them, and the variance in all others."""
    count, columns = centred.shape
    is_tall = count >= columns
    variances, vectors = eigh((centred.T @ centred if is_tall else centred @ centred.T) / count)
    variances, vectors = np.maximum(variances[::-1], 0.0), vectors[:, ::-1]
    trace = float(variances.sum())
    weight = shrinkage(centred, trace, float(variances @ variances))
    kept = min(max(most, LEAST_DIRECTIONS), count - 1, columns)
    base, others = weight * trace / columns, columns - kept
    beside = (1.0 - weight) * float(variances[kept:].sum()) / others if others else 0.0
    noise = max(base + beside, _LEAST_NOISE)
    directions = vectors[:, :kept] if is_tall else centred.T @ vectors[:, :kept]
    is_real = variances[:kept] > _ROUNDING * trace  # others point anywhere, and have no variance
    lengths = np.where(is_real, np.linalg.norm(directions, axis=0), np.inf)
    components = (directions / lengths).T.astype(np.float32).astype(np.float64)  # as in a card
    return components, np.maximum((1.0 - weight) * variances[:kept] + base, noise), noise
