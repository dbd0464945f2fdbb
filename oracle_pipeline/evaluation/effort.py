"""How many runs a person must inspect to find the attacked ones: small clusters, effort curves.

The small-cluster protocol uses no labels and clusters all runs at once. Failures are rare and
differ from each other, so small clusters are inspected first [1]_.

References
----------
.. [1] R. Almaghairbe, M. Roper, "Building test oracles by clustering failures", AST 2015.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.metrics import adjusted_rand_score

from oracle_pipeline.bootstrap import distinct_runs
from oracle_pipeline.clustering.tree import Linkage, grow_tree
from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.evaluation.metrics import share
from oracle_pipeline.evaluation.variants import scale_rows

KAPPAS = (0.05, 0.1, 0.15, 0.2, 0.25)  # clusters over runs
BUDGET = 0.25  # share of the runs that a person inspects
METHODS: tuple[Linkage, ...] = ("average", "ward")


class EffortCurve(NamedTuple):
    """Share of attacked runs found over share of runs inspected; arrays of equal shape."""

    inspected: NDArray[np.float64]
    found: NDArray[np.float64]

    def at(self, budget: float) -> float:
        """Return the share found once at most `budget` of the runs are inspected."""
        return float(self.found[np.searchsorted(self.inspected, budget + 1e-9) - 1])


def effort_curve(suspicion: NDArray[np.float64], malicious: NDArray[np.bool_]) -> EffortCurve:
    """Return the effort of inspecting runs by falling suspicion, equal ones together.

    Parameters
    ----------
    suspicion : ndarray of shape (n_runs,)
        Runs with NaN are left out.
    malicious : ndarray of bool, shape (n_runs,)
        At least one run with a suspicion must be malicious.

    Returns
    -------
    EffortCurve
        From (0, 0) to (1, 1), a point for each distinct suspicion.
    """
    scored = ~np.isnan(suspicion)
    level, place = np.unique(-suspicion[scored], return_inverse=True)
    inspected = np.append(0.0, np.cumsum(np.bincount(place, minlength=len(level))))
    attacks_found = np.append(0.0, np.cumsum(np.bincount(place, weights=malicious[scored])))
    return EffortCurve(inspected / inspected[-1], attacks_found / attacks_found[-1])


def smallness(clusters: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the negative size of each row's cluster, shape (n_rows,)."""
    return -np.bincount(clusters)[clusters].astype(np.float64)


def in_small_cluster(clusters: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return a mask of the rows in clusters smaller than the mean size."""
    mean = len(clusters) / len(np.unique(clusters))
    return np.asarray(-smallness(clusters) < mean, dtype=np.bool_)


def small_clusters_table(
    df: pd.DataFrame, columns: Sequence[str], rng: np.random.Generator
) -> pd.DataFrame:
    """Evaluate the small-cluster protocol for each linkage and number of clusters.

    Columns: ``failure_share`` (share of attacked runs among those in small clusters), ``found``
    (share of the attacked runs that are in small clusters), ``inspected`` (share of all runs that
    are in small clusters), ``found_in_budget`` (share of the attacked runs found by inspecting at
    most a quarter of the runs, smallest clusters first), ``ari`` (adjusted Rand index of clusters
    and kinds of behaviour: normal, and each attack).

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    columns : sequence of str
        Features to cluster by.
    rng : Generator
        Draws the resamples for the intervals.

    Raises
    ------
    ClusteringError
        The rows cannot be clustered.
    """
    X, runs = scale_rows(df, columns), distinct_runs(df)
    malicious, block = is_malicious(df), df["block"].to_numpy(dtype=np.int64)
    kinds = np.where(malicious, df["mode"], "normal")
    table = []
    for method in METHODS:
        tree = grow_tree(X, method)
        for kappa in KAPPAS:
            clusters = tree.cut("maxclust", max(1, round(kappa * len(runs))))
            small = in_small_cluster(clusters)
            row = {"linkage": method, "kappa": kappa, "clusters": len(np.unique(clusters))}
            row |= share(malicious[small], block[small], rng).columns("failure_share")
            row |= share(small[malicious], block[malicious], rng).columns("found")
            row |= {"inspected": float(small.mean())}
            if malicious.any():
                row["found_in_budget"] = effort_curve(smallness(clusters), malicious).at(BUDGET)
            row["ari"] = float(adjusted_rand_score(kinds, clusters))
            table.append(row)
    return pd.DataFrame(table)
