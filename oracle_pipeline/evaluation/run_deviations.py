"""What is unusual in each run: outside the usual range of the normal runs of other blocks."""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import feature_floors, is_malicious
from oracle_pipeline.detectors import Deviation
from oracle_pipeline.scoring.evidence import ranked_deviations, usual_ranges
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
    signals, floors = common_signals(normal, settings_among(normal)), feature_floors(df)
    found: dict[str, list[Deviation]] = {}
    block_of, run_of = df["block"].to_numpy(), df["run_id"].to_numpy()
    for block in np.unique(block_of):
        others = normal[normal["block"] != block]
        if others.empty or not np.isfinite(others[columns].to_numpy()).any():
            continue
        of_others = signals if len(others) >= FEWEST_IN_RANGE else ()
        usual = usual_ranges(others, columns, of_others, floors)
        found |= {
            str(run_of[row]): ranked_deviations(usual, df.iloc[[row]])
            for row in np.flatnonzero(block_of == block).tolist()
        }
    return found
