"""Measures how well a clustering separates attacked from normal runs, in two ways."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bootstrap import DistinctRuns, distinct_runs, lacking
from oracle_pipeline.clustering.tree import (
    ClusteringError,
    Criterion,
    Linkage,
    Tree,
    grow_tree,
    hac_height,
    outside_largest,
)
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate
from oracle_pipeline.evaluation.metrics import (
    Confusion,
    auc,
    confusion,
    false_positive_rate,
    true_positive_rate,
)
from oracle_pipeline.evaluation.variants import CORRECTED, MethodVariant


@dataclass(frozen=True, slots=True)
class ClusteringResult:
    """The result of one clustering; if it failed, estimates are empty and `note` has the reason.

    The verdict without labels calls every run outside the largest cluster anomalous. The thesis
    instead takes the cluster with most of the malicious rows as the malicious one, which uses the
    labels. It calls the recall of that cluster accuracy, and its balanced accuracy AUC.
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
    accuracy: float = np.nan  # by rows, so a rare class hardly counts
    f1: float = np.nan  # of the malicious rows
    auc: Estimate = NOTHING  # of the HAC height, with all rows as reference
    recall_best_cluster: Estimate = NOTHING
    fpr_best_cluster: Estimate = NOTHING
    balanced_accuracy_best_cluster: Estimate = NOTHING
    mcc_best_cluster: float = np.nan  # by distinct runs, as decoded from the thesis
    runs_best_cluster: str = ""  # its number of distinct runs of each class, as text
    note: str = ""

    def columns(self) -> dict[str, float | int | str]:
        """Return the result as table columns, an estimate as three."""
        row: dict[str, float | int | str] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            row |= value.columns(field.name) if isinstance(value, Estimate) else {field.name: value}
        return row


def in_words(counts: Confusion) -> str:
    """Return as text how many runs of each class are called anomalous.

    Examples
    --------
    >>> in_words(Confusion(tp=43, fp=42, fn=2, tn=3))
    '43/45 malicious, 42/45 others'
    """
    malicious, others = counts.tp + counts.fn, counts.fp + counts.tn
    return f"{counts.tp}/{malicious} malicious, {counts.fp}/{others} others"


def in_best_cluster(
    clusters: NDArray[np.int32], runs: DistinctRuns, inspected: int | None = None
) -> NDArray[np.bool_]:
    """Return a mask of the runs in the cluster with most malicious rows (the first, if tied).

    This is how the thesis interprets a result. It is not a verdict, because the cluster is chosen
    with the labels that it is then compared with.

    Parameters
    ----------
    clusters : ndarray of shape (n_runs,)
        Numbered from 1.
    runs : DistinctRuns
    inspected : int, optional
        Consider clusters up to this number only. If none of them has a malicious row, no run is in
        the best cluster.
    """
    held = np.bincount(clusters, weights=runs.copies * runs.malicious)
    considered = held if inspected is None else held[: inspected + 1]
    return np.asarray(clusters == np.argmax(considered), dtype=np.bool_)


def grow_over_rows(
    rows: pd.DataFrame, columns: Sequence[str], method: Linkage, variant: MethodVariant = CORRECTED
) -> Tree:
    """Agglomerate rows by the columns and the matrix of a variant.

    Raises
    ------
    ClusteringError
        Fewer than two distinct runs, too many rows, or no feature with a finite value.
    """
    if len(distinct_runs(rows)) < 2:
        raise ClusteringError("Copies of one run have no clusters; at least two runs are needed.")
    return grow_tree(variant.matrix(rows, columns), method)


def cluster_and_judge(
    rows: pd.DataFrame,
    columns: Sequence[str],
    rng: np.random.Generator,
    method: Linkage = "ward",
    criterion: Criterion = "maxclust",
    t: float = 2.0,
    variant: MethodVariant = CORRECTED,
) -> ClusteringResult:
    """Cluster rows and compute the metrics; a failure gives a result with the reason.

    Parameters
    ----------
    rows : DataFrame
        May have copies of runs.
    columns : sequence of str
        Features to use.
    rng : Generator
        Draws the resamples for the intervals.
    method, criterion, t
        How the tree is grown and cut.
    variant : MethodVariant
        Selects the columns and how the best cluster is found.
    """
    runs = distinct_runs(rows)
    try:
        tree = grow_over_rows(rows, columns, method, variant)
    except ClusteringError as error:
        return ClusteringResult(rows=len(rows), runs=len(runs), note=str(error))
    of_rows = tree.cut(criterion, t)
    clusters, flagged = of_rows[runs.first], outside_largest(of_rows)[runs.first]
    numbered_to_t = variant.first_clusters_only and criterion == "distance"
    best = in_best_cluster(clusters, runs, inspected=int(t) if numbered_to_t else None)
    counts = confusion(flagged, runs)
    counts_best = confusion(best, replace(runs, copies=np.ones_like(runs.copies)))
    return ClusteringResult(
        rows=len(rows), runs=len(runs), clusters=len(np.unique(clusters)), tp=counts.tp,
        fp=counts.fp, fn=counts.fn, tn=counts.tn, tpr=true_positive_rate(flagged, runs),
        fpr=false_positive_rate(flagged, runs),
        balanced_accuracy=auc(flagged.astype(np.float64), runs, rng), mcc=counts.mcc,
        accuracy=(counts.tp + counts.tn) / len(rows),
        f1=2.0 * counts.tp / max(1, 2 * counts.tp + counts.fp + counts.fn),
        auc=auc(hac_height(tree)[runs.first], runs, rng),
        recall_best_cluster=true_positive_rate(best, runs),
        fpr_best_cluster=false_positive_rate(best, runs),
        balanced_accuracy_best_cluster=auc(best.astype(np.float64), runs, rng),
        mcc_best_cluster=counts_best.mcc, runs_best_cluster=in_words(counts_best),
        note=lacking(rows),
    )  # fmt: skip
