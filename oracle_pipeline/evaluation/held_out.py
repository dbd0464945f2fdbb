"""The HAC height of each run against right runs of other blocks: no copies and no leak."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import FlooredRobustScaler
from oracle_pipeline.clustering.scores import hac_height
from oracle_pipeline.clustering.tree import Linkage, grow_tree
from oracle_pipeline.datasets import feature_floors, is_malicious


def held_out_heights(
    df: pd.DataFrame, columns: Sequence[str], method: Linkage = "average"
) -> NDArray[np.float64]:
    """Score every run by when it joins the right runs of all blocks but its own.

    Scaling is fitted on those runs alone, and the tree holds them and the one run that is scored,
    so a score depends neither on the run's label nor on which other runs are scored.

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    columns : sequence of str
        Features to use.
    method : {"ward", "single", "complete", "average"}
        Average linkage tells a lone odd run from a minor cluster of right ones, which Ward does not
        (measured in docs/clustering.md).

    Returns
    -------
    ndarray of shape (n_runs,)
        Higher is more anomalous; NaN where the other blocks hold no right run with a finite value.
    """
    block = df["block"].to_numpy()
    right = ~is_malicious(df)
    features, floors = df[list(columns)], feature_floors(df)
    heights = np.full(len(df), np.nan)
    for held_out in np.unique(block):
        reference = right & (block != held_out)
        if not np.isfinite(features[reference].to_numpy()).any():
            continue
        scaler = FlooredRobustScaler(floors).fit(features[reference])
        known, scored = scaler.transform(features[reference]), block == held_out
        is_reference = np.append(np.ones(len(known), dtype=np.bool_), False)
        for row, x in zip(np.flatnonzero(scored), scaler.transform(features[scored]), strict=True):
            tree = grow_tree(np.vstack([known, x]), method)
            heights[row] = hac_height(tree, is_reference)[-1]
    return heights
