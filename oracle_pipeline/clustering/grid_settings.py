"""The settings of a grid search over clusterings, and the measures for selection."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.clustering.tree import CRITERIA, LINKAGES, ClusteringError, Criterion, Linkage

Metric = Literal["euclidean", "cosine", "correlation"]
Measure = Literal["balanced_accuracy", "accuracy", "auc", "f1", "mcc"]
METRICS: tuple[Metric, ...] = get_args(Metric)
MEASURES: tuple[Measure, ...] = get_args(Measure)


@dataclass(frozen=True, slots=True)
class GridSettings:
    """The settings of a grid search; the defaults are the thesis's.

    Attributes
    ----------
    linkages : tuple of str
    metrics : tuple of str
    thresholds : tuple of float
        Number of clusters (``maxclust``) or distance (``distance``).
    select_by : str
        Measure to maximise. Selection uses labels, so the result is an upper bound, not a verdict.

    Raises
    ------
    ClusteringError
        A name does not exist.
    """

    linkages: tuple[Linkage, ...] = LINKAGES
    metrics: tuple[Metric, ...] = ("euclidean",)
    thresholds: tuple[float, ...] = (2.0, 4.0)
    select_by: Measure = "balanced_accuracy"
    criteria: tuple[Criterion, ...] = CRITERIA

    def __post_init__(self) -> None:
        for what, given, known in (
            ("linkage", self.linkages, LINKAGES),
            ("metric", self.metrics, METRICS),
            ("measure", (self.select_by,), MEASURES),
        ):
            for name in given:
                if name not in known:
                    raise ClusteringError(
                        f"There is no {what} {name!r} in the grid; there are {', '.join(known)}."
                    )


def in_metric(X: NDArray[np.float64], metric: Metric) -> NDArray[np.float64]:
    """Transform rows so that Euclidean distances are monotonic in distances of a metric.

    For rows of length 1, the squared Euclidean distance is twice the cosine distance. If each row
    is centred first, it is twice the correlation distance. A row of length 0 is not changed.

    Examples
    --------
    >>> in_metric(np.array([[3.0, 4.0], [6.0, 8.0]]), "cosine")
    array([[0.6, 0.8],
           [0.6, 0.8]])
    """
    if metric == "euclidean":
        return X
    if metric == "correlation":
        X = X - X.mean(axis=1, keepdims=True)
    length = np.linalg.norm(X, axis=1, keepdims=True)
    return np.asarray(X / np.where(length > 0.0, length, 1.0), dtype=np.float64)
