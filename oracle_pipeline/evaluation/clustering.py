"""How well one clustering tells attacked runs from right ones, by our reading and the thesis's."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import FlooredRobustScaler
from oracle_pipeline.clustering.scores import hac_height, outside_largest
from oracle_pipeline.clustering.tree import (
    ClusteringError,
    Criterion,
    GridPoint,
    Linkage,
    grow_tree,
)
from oracle_pipeline.datasets import DistinctRuns, distinct_runs, feature_floors, lacking
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate
from oracle_pipeline.evaluation.metrics import (
    auc,
    confusion,
    false_positive_rate,
    true_positive_rate,
)


@dataclass(frozen=True, slots=True)
class ClusteringResult:
    """One clustering judged; estimates are nothing, and `note` says why, where it could not be.

    The verdict without labels: every run outside the largest cluster is anomalous. The thesis's
    reading: the cluster that holds most of the malicious rows, chosen with the labels, is the
    malicious one; its recall is what the thesis calls accuracy.
    """

    rows: int = 0  # clustered, copies included
    runs: int = 0  # distinct
    clusters: int = 0
    tp: int = 0  # rows, by the verdict without labels
    fp: int = 0
    fn: int = 0
    tn: int = 0
    tpr: Estimate = NOTHING
    fpr: Estimate = NOTHING
    balanced_accuracy: Estimate = NOTHING
    mcc: float = np.nan
    auc: Estimate = NOTHING  # of the HAC height, all rows being the reference
    recall_best_cluster: Estimate = NOTHING
    fpr_best_cluster: Estimate = NOTHING
    balanced_accuracy_best_cluster: Estimate = NOTHING  # the thesis's AUC
    note: str = ""

    def columns(self) -> dict[str, float | int | str]:
        """Return the result as table columns, an estimate as three."""
        row: dict[str, float | int | str] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            row |= value.columns(field.name) if isinstance(value, Estimate) else {field.name: value}
        return row


def scale_rows(rows: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.float64]:
    """Scale the named features of the rows, floors as declared; shape (n_rows, n_scaled)."""
    scaler = FlooredRobustScaler(feature_floors(rows))
    return np.asarray(scaler.fit_transform(rows[list(columns)]), dtype=np.float64)


def in_best_cluster(clusters: NDArray[np.int32], runs: DistinctRuns) -> NDArray[np.bool_]:
    """Tell which runs are in the cluster with most of the malicious rows (the first, if tied).

    This looks at the labels that it is then measured against: it reads a result as the thesis does
    and is no verdict.
    """
    held = np.bincount(clusters, weights=runs.copies * runs.malicious)
    return np.asarray(clusters == np.argmax(held), dtype=np.bool_)


def judge(rows: pd.DataFrame, point: GridPoint, rng: np.random.Generator) -> ClusteringResult:
    """Measure one clustering of the rows.

    Parameters
    ----------
    rows : DataFrame of n rows
        What was clustered; copies of runs allowed.
    point : GridPoint
        Tree and clusters over those rows.
    rng : Generator
        Draws the resamples behind the intervals.
    """
    runs = distinct_runs(rows)
    height = hac_height(point.tree)[runs.first]
    flagged = outside_largest(point.clusters)[runs.first]
    best = in_best_cluster(point.clusters[runs.first], runs)
    counts = confusion(flagged, runs)
    return ClusteringResult(
        rows=len(rows),
        runs=len(runs),
        clusters=len(np.unique(point.clusters)),
        tp=counts.tp,
        fp=counts.fp,
        fn=counts.fn,
        tn=counts.tn,
        tpr=true_positive_rate(flagged, runs),
        fpr=false_positive_rate(flagged, runs),
        balanced_accuracy=auc(flagged.astype(np.float64), runs, rng),
        mcc=counts.mcc,
        auc=auc(height, runs, rng),
        recall_best_cluster=true_positive_rate(best, runs),
        fpr_best_cluster=false_positive_rate(best, runs),
        balanced_accuracy_best_cluster=auc(best.astype(np.float64), runs, rng),
        note=lacking(rows),
    )


def cluster_and_judge(
    rows: pd.DataFrame,
    columns: Sequence[str],
    rng: np.random.Generator,
    method: Linkage = "ward",
    criterion: Criterion = "maxclust",
    t: float = 2.0,
) -> ClusteringResult:
    """Scale, cluster and measure; rows that cannot be clustered give a result that says why."""
    try:
        tree = grow_tree(scale_rows(rows, columns), method)
    except ClusteringError as error:
        return ClusteringResult(rows=len(rows), runs=len(distinct_runs(rows)), note=str(error))
    return judge(rows, GridPoint(tree, criterion, t, tree.cut(criterion, t)), rng)
