"""Simple detectors on plain statistics, as anyone can write them in an hour."""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import LedoitWolf
from sklearn.decomposition import PCA
from sklearn.ensemble import IsolationForest

Floats: TypeAlias = NDArray[np.float64]
Baseline: TypeAlias = Callable[[Floats, Floats], Floats]  # fitted rows, new rows: scores

PLAIN = ("mean", "std", "min", "max", "change")  # statistics of each number
_CLIP = 50.0
_EXPLAINED = 0.95  # share of the variance that PCA keeps


def scaled(normal: Floats, new: Floats) -> tuple[Floats, Floats]:
    """Return both in robust units of the normal rows; missing numbers are 0."""
    centre = np.nanmedian(normal, axis=0)
    mad = 1.4826 * np.nanmedian(np.abs(normal - centre), axis=0)
    scale = np.fmax(np.fmax(mad, 0.5 * np.nanstd(normal, axis=0)), 1e-9 * np.abs(centre))
    scale[~(scale > 0.0)] = 1.0
    both = ((rows - centre) / scale for rows in (normal, new))
    first, second = (np.nan_to_num(np.clip(rows, -_CLIP, _CLIP)) for rows in both)
    return first, second


def pca(normal: Floats, new: Floats) -> Floats:
    """Return Hotelling's T2 and the squared residual Q, each over its mean among normal rows."""
    model = PCA(_EXPLAINED).fit(normal)

    def parts(rows: Floats) -> tuple[Floats, Floats]:
        along = model.transform(rows)
        beside = rows - model.inverse_transform(along)
        return (along**2 / model.explained_variance_).sum(axis=1), (beside**2).sum(axis=1)

    usual = [max(float(part.mean()), 1e-9) for part in parts(normal)]
    t2, q = parts(new)
    return np.asarray(t2 / usual[0] + q / usual[1], dtype=np.float64)


def mahalanobis(normal: Floats, new: Floats) -> Floats:
    """Return the distance in the covariance that is shrunk after Ledoit and Wolf."""
    return np.asarray(LedoitWolf().fit(normal).mahalanobis(new), dtype=np.float64)


def largest_z(count: int) -> Baseline:
    """Return the detector that averages the largest robust z."""

    def score(_: Floats, new: Floats) -> Floats:
        return np.asarray(np.sort(np.abs(new), axis=1)[:, -count:].mean(axis=1), dtype=np.float64)

    return score


def isolation_forest(normal: Floats, new: Floats) -> Floats:
    """Return the score of an isolation forest of 300 trees."""
    forest = IsolationForest(n_estimators=300, random_state=0).fit(normal)
    return np.asarray(-forest.score_samples(new), dtype=np.float64)


BASELINES: Mapping[str, Baseline] = {
    "PCA T2+Q": pca,
    "Mahalanobis": mahalanobis,
    "z, 3 largest": largest_z(3),
    "z, 10 largest": largest_z(10),
    "isolation forest": isolation_forest,
}
