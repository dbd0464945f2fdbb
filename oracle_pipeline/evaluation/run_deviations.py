"""What is unusual in each run: outside the usual range of the normal runs of other blocks."""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import feature_floors, is_malicious
from oracle_pipeline.detectors import Deviation, SignalScaler, UsualRanges
from oracle_pipeline.scoring.feature_sets import feature_sets
from oracle_pipeline.scoring.learning import FEWEST_IN_RANGE, common_signals, settings_among


def deviations_of_runs(df: pd.DataFrame) -> dict[str, list[Deviation]]:
    """Return the unusual features and signals of every run, the farthest first.

    Parameters
    ----------
    df : DataFrame
        Distinct runs of one kind of system, one row each.

    Returns
    -------
    dict of str to list of Deviation
        By run. A run is left out if no other block has normal runs.
    """
    df = df.copy()  # defragmented: pandas then selects rows twice as fast
    columns = feature_sets(df).get("all", [])
    normal = df[~is_malicious(df)]
    signals = common_signals(normal, settings_among(normal))
    found: dict[str, list[Deviation]] = {}
    block_of, run_of = df["block"].to_numpy(), df["run_id"].to_numpy()
    for block in np.unique(block_of):
        others = normal[normal["block"] != block]
        if others.empty or not np.isfinite(others[columns].to_numpy()).any():
            continue
        usual = [UsualRanges(others, columns)]
        if signals and len(others) >= FEWEST_IN_RANGE:
            usual.append(UsualRanges(others, signals, SignalScaler(feature_floors(df))))
        for row in np.flatnonzero(block_of == block).tolist():
            each = [one for ranges in usual for one in ranges.deviations(df.iloc[[row]])]
            found[str(run_of[row])] = sorted(each, key=lambda one: -abs(one.z))
    return found
