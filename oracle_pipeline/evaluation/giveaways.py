"""Features that show an attack: outside the usual range of the normal runs of other blocks."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.detectors import Deviation, UsualRanges
from oracle_pipeline.scoring.feature_sets import feature_sets

SHOWN = 5  # features of each mode
COLUMNS = ("mode", "feature", "runs", "outside", "normal", "outside_normal", "median_z")


def deviations_of_runs(df: pd.DataFrame) -> dict[str, list[Deviation]]:
    """Return the unusual features of every run, the farthest first.

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
    found: dict[str, list[Deviation]] = {}
    block_of, run_of = df["block"].to_numpy(), df["run_id"].to_numpy()
    for block in np.unique(block_of):
        others = normal[normal["block"] != block]
        if others.empty or not np.isfinite(others[columns].to_numpy()).any():
            continue
        usual = UsualRanges(others, columns)
        found |= {
            str(run_of[row]): usual.deviations(df.iloc[[row]])
            for row in np.flatnonzero(block_of == block).tolist()
        }
    return found


def giveaways(df: pd.DataFrame, deviations: Mapping[str, Sequence[Deviation]]) -> pd.DataFrame:
    """Return the features that distinguish the runs of each attacked mode from normal runs.

    Parameters
    ----------
    df : DataFrame
        The runs.
    deviations : mapping of str to sequence of Deviation
        From `deviations_of_runs`.

    Returns
    -------
    DataFrame
        At most five rows for each mode: ``mode``, ``feature``, ``runs`` of the mode, ``outside``
        (how many of them are outside the usual range), ``normal``, ``outside_normal`` (the same for
        normal runs) and ``median_z`` of the runs that are outside. Features with the largest
        difference between the two shares come first.
    """
    known = df[df["run_id"].isin(deviations)]
    normal = set(known.loc[~is_malicious(known), "run_id"])
    attacked = known[is_malicious(known)]
    of_normal = _z_by_feature(deviations, normal)
    tables = []
    for mode, runs in attacked.groupby("mode", sort=False)["run_id"]:
        z = _z_by_feature(deviations, set(runs))
        table = pd.DataFrame(
            {
                "mode": mode,
                "feature": list(z),
                "runs": len(runs),
                "outside": [len(each) for each in z.values()],
                "normal": len(normal),
                "outside_normal": [len(of_normal.get(feature, [])) for feature in z],
                "median_z": [float(np.median(each)) for each in z.values()],
            }
        )
        difference = table["outside"] / len(runs) - table["outside_normal"] / max(1, len(normal))
        order = np.lexsort((-table["median_z"].abs(), -difference))
        tables.append(table.iloc[order[:SHOWN]])
    if not tables:
        return pd.DataFrame(columns=COLUMNS)
    return pd.concat(tables, ignore_index=True)


def _z_by_feature(
    deviations: Mapping[str, Sequence[Deviation]], runs: set[str]
) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for run in sorted(runs):
        for deviation in deviations[run]:
            found.setdefault(deviation.feature, []).append(deviation.z)
    return found
