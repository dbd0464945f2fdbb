"""The thesis's method in two variants: as its code computes it, and corrected.

Both draw runs with replacement and cluster their rows. They differ in features, sampling and
scaling; docs/explanation/thesis.md lists the differences.
``oracle_pipeline.evaluation.clustering_result`` measures how good a clustering is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bootstrap import bootstrap
from oracle_pipeline.clustering.scaling import FlooredRobustScaler
from oracle_pipeline.datasets import DatasetError, feature_columns, feature_floors, is_malicious
from oracle_pipeline.features.traffic.thesis_features import VECTOR

FeatureSet = Literal["all", "structural", "contextual"]
VariantName = Literal["corrected", "thesis"]

#: Feature families that the thesis calls "all".
ALL_FAMILIES = ("structural", "contextual")

# Slices of the thesis's vector. Its contextual slice begins at 8 and so omits yaw variance, 7.
_SLICES: dict[FeatureSet, tuple[str, ...]] = {
    "all": VECTOR,
    "structural": VECTOR[:7],
    "contextual": VECTOR[8:],
}


@dataclass(frozen=True, slots=True)
class MethodVariant:
    """One variant of the path from runs to clustered rows, and to the cluster that is judged.

    Parameters
    ----------
    name : {"corrected", "thesis"}
    whole_runs : callable
        Takes a feature table and returns its usable runs.
    columns : callable
        Takes a feature table and a set of features, and returns the columns.
    draw : callable
        Takes usable runs, a number of rows, a malicious rate and a seed, and returns the rows.
    matrix : callable
        Takes rows and columns, and returns the matrix to cluster, shape (n_rows, n_columns).
    first_clusters_only : bool
        Look for the best cluster among those numbered 1 to t, even where t is a distance.
    """

    name: VariantName
    whole_runs: Callable[[pd.DataFrame], pd.DataFrame]
    columns: Callable[[pd.DataFrame, FeatureSet], list[str]]
    draw: Callable[[pd.DataFrame, int, float, int], pd.DataFrame]
    matrix: Callable[[pd.DataFrame, Sequence[str]], NDArray[np.float64]]
    first_clusters_only: bool


def _scale_rows(rows: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.float64]:
    """Scale the named features with their declared floors; shape (n_rows, n_scaled)."""
    scaler = FlooredRobustScaler(feature_floors(rows))
    return np.asarray(scaler.fit_transform(rows[list(columns)]), dtype=np.float64)


def _of_whole_vectors(df: pd.DataFrame) -> pd.DataFrame:
    """Drop runs with an incomplete vector, which the thesis's code cannot put into an array.

    Raises
    ------
    DatasetError
        No run is left.
    """
    absent = [name for name in VECTOR if name not in df.columns]
    whole = df if absent else df[df[list(VECTOR)].notna().all(axis=1)]
    if absent or whole.empty:
        raise DatasetError(
            "No run has all ten features of the thesis's variant "
            f"(without any value: {', '.join(absent) or 'none'}); extract the runs' features again "
            "with the built-in plugins, or use the corrected variant."
        )
    return whole


def _sample(df: pd.DataFrame, n: int, malicious_rate: float, seed: int) -> pd.DataFrame:
    """Draw rows as the thesis's code does: normal ones with `seed`, malicious ones with `seed + 1`.

    Raises
    ------
    DatasetError
        A class to draw from has no run.
    """
    malicious = is_malicious(df)
    n_malicious = int(n * malicious_rate)
    parts = []
    for runs, size, name, state in (
        (df[~malicious], n - n_malicious, "normal", seed),
        (df[malicious], n_malicious, "malicious", seed + 1),
    ):
        if size and runs.empty:
            raise DatasetError(
                f"There is no {name} run to draw {size} rows from; record runs of a {name} mode."
            )
        parts.append(runs.sample(size, replace=True, random_state=state))
    return pd.concat(parts, ignore_index=True)


CORRECTED = MethodVariant(
    name="corrected",
    whole_runs=lambda df: df,
    columns=lambda df, name: feature_columns(df, ALL_FAMILIES if name == "all" else [name]),
    draw=bootstrap,
    matrix=_scale_rows,
    first_clusters_only=False,
)
THESIS = MethodVariant(
    name="thesis",
    whole_runs=_of_whole_vectors,
    columns=lambda _, features: list(_SLICES[features]),
    draw=_sample,
    matrix=lambda rows, columns: rows[list(columns)].to_numpy(dtype=np.float64),
    first_clusters_only=True,
)
VARIANTS: dict[VariantName, MethodVariant] = {"corrected": CORRECTED, "thesis": THESIS}
