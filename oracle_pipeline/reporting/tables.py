"""The thesis's tables made from our runs, its figures in the columns ``thesis_*``, and our own.

Functions of a feature table and a generator to a DataFrame; nothing is drawn or written here. An
estimate takes up three columns, ``auc``, ``auc_low`` and ``auc_high``; `estimate` puts it together.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scores import small_cluster_score
from oracle_pipeline.clustering.tree import ClusteringError, grid_search, grow_tree
from oracle_pipeline.datasets import (
    PAIRS,
    DatasetError,
    bootstrap,
    distinct_runs,
    feature_columns,
    feature_families,
    lacking,
)
from oracle_pipeline.evaluation.clustering import (
    ClusteringResult,
    cluster_and_judge,
    judge,
    scale_rows,
)
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.held_out import held_out_heights
from oracle_pipeline.evaluation.metrics import auc
from oracle_pipeline.reporting.thesis_figures import (
    ALL_FAMILIES,
    FAMILIES,
    GRID,
    PAIRWISE,
    RATES,
    THRESHOLD,
    ThesisFigure,
)

FAMILY_SETS = ("all", "structural", "contextual")
MALICIOUS_RATES = (0.1, 0.3, 0.5, 0.7, 0.9)
ALL_MODES = "all modes"
KAPPA = 0.2  # clusters over runs, the upper end of what the literature uses


def estimate(row: pd.Series, name: str) -> Estimate:
    """Put the estimate of a table row back together."""
    return Estimate(*(float(row[f"{name}{end}"]) for end in ("", "_low", "_high")))


def grid_search_table(
    rows: pd.DataFrame, rng: np.random.Generator, thresholds: Sequence[float] = (2.0, 4.0)
) -> pd.DataFrame:
    """Judge every linkage, criterion and threshold on the same rows (the thesis's table 5.1).

    The thesis's figures stand in the rows that have its threshold: 2 for Ward, 4 otherwise; its
    distances are of unscaled features, so only its ``maxclust`` rows ask the same question as ours.

    Parameters
    ----------
    rows : DataFrame
        Bootstrapped rows.
    rng : Generator
        Draws the resamples behind the intervals.
    thresholds : sequence of float
        Clusters (``maxclust``) or distance in scales (``distance``).

    Raises
    ------
    ClusteringError
        Fewer than two rows, or no feature with a finite value.
    """
    X = scale_rows(rows, feature_columns(rows, ALL_FAMILIES))
    table = []
    for point in grid_search(X, thresholds=thresholds):
        method, criterion = point.tree.method, point.criterion
        thesis = GRID[method, criterion] if point.t == THRESHOLD[method] else None
        setting = {"linkage": method, "criterion": criterion, "t": point.t}
        table.append(setting | judge(rows, point, rng).columns() | _beside(thesis))
    return pd.DataFrame(table)


def malicious_rate_table(
    df: pd.DataFrame,
    n: int,
    seed: int,
    rng: np.random.Generator,
    rates: Sequence[float] = MALICIOUS_RATES,
) -> pd.DataFrame:
    """Cluster bootstraps with different shares of malicious rows (the thesis's table 6.1).

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    n, seed : int
        Of each bootstrap.
    rng : Generator
        Draws the resamples behind the intervals.
    rates : sequence of float
        Shares of malicious rows.
    """
    columns = feature_columns(df, ALL_FAMILIES)
    table = []
    for rate in rates:
        result = _bootstrap_and_judge(df, columns, n, rate, seed, rng)
        table.append({"malicious_rate": rate} | result.columns() | _beside(RATES.get(rate)))
    return pd.DataFrame(table)


def family_table(
    df: pd.DataFrame, n: int, malicious_rate: float, seed: int, rng: np.random.Generator
) -> pd.DataFrame:
    """Cluster all modes on each set of features (the thesis's sections 6.2 to 6.4).

    Parameters are those of `malicious_rate_table`, with one rate.
    """
    table = []
    for family in FAMILY_SETS:
        result = _bootstrap_and_judge(df, _columns(df, family), n, malicious_rate, seed, rng)
        place = {"scope": ALL_MODES, "features": family}
        table.append(place | result.columns() | _beside(FAMILIES[family]))
    return pd.DataFrame(table)


def pairwise_table(
    df: pd.DataFrame, n: int, malicious_rate: float, seed: int, rng: np.random.Generator
) -> pd.DataFrame:
    """Cluster each attacked mode with its control on each set of features (the thesis's table 6.2).

    Parameters are those of `malicious_rate_table`, with one rate.
    """
    table = []
    for control, attacked in PAIRS:
        pair = df[df["mode"].isin([control, attacked])]
        for family in FAMILY_SETS:
            result = _bootstrap_and_judge(pair, _columns(df, family), n, malicious_rate, seed, rng)
            place = {"scope": f"{control} / {attacked}", "features": family}
            table.append(place | result.columns() | _beside(PAIRWISE.get((attacked, family))))
    return pd.DataFrame(table)


def evaluation_table(df: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Judge continuous scores on the distinct runs, by feature family: our method, no copies.

    The HAC height of a run is taken against right runs of other blocks; the small-cluster score
    uses no label at all and all runs at once. Each is judged over all modes and for each attacked
    mode against its control.

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    rng : Generator
        Draws the resamples behind the intervals.
    """
    table = []
    for family in ("all", *feature_families(df)):
        columns = feature_columns(df, None if family == "all" else [family])
        height, small = held_out_heights(df, columns), _small_clusters(df, columns)
        for scope, members in _scopes(df):
            row = _judged_scores(df[members], height[members], small[members], rng)
            table.append({"scope": scope, "features": family, **row})
    return pd.DataFrame(table)


def _small_clusters(df: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.float64]:
    try:
        return small_cluster_score(grow_tree(scale_rows(df, columns)), KAPPA)
    except ClusteringError:
        return np.full(len(df), np.nan)


def _judged_scores(
    df: pd.DataFrame,
    height: NDArray[np.float64],
    small: NDArray[np.float64],
    rng: np.random.Generator,
) -> dict[str, float | int | str]:
    runs = distinct_runs(df)
    held_out = auc(height[runs.first], runs, rng)
    return {
        "malicious": int(runs.malicious.sum()),
        "right": int((~runs.malicious).sum()),
        **held_out.columns("auc"),
        **auc(small[runs.first], runs, rng).columns("auc_small_clusters"),
        "note": lacking(df) or ("no run could be scored" if np.isnan(held_out.value) else ""),
    }


def _scopes(df: pd.DataFrame) -> list[tuple[str, NDArray[np.bool_]]]:
    pairs = [(f"{c} / {a}", np.asarray(df["mode"].isin([c, a]))) for c, a in PAIRS]
    present = [(name, members) for name, members in pairs if members.any()]
    return [(ALL_MODES, np.ones(len(df), dtype=np.bool_)), *present]


def _columns(df: pd.DataFrame, family: str) -> list[str]:
    return feature_columns(df, ALL_FAMILIES if family == "all" else [family])


def _bootstrap_and_judge(
    df: pd.DataFrame,
    columns: Sequence[str],
    n: int,
    malicious_rate: float,
    seed: int,
    rng: np.random.Generator,
) -> ClusteringResult:
    """Cluster a bootstrap with the thesis's setting, Ward and two clusters."""
    try:
        rows = bootstrap(df, n, malicious_rate, seed)
    except DatasetError as error:
        return ClusteringResult(note=str(error))
    return cluster_and_judge(rows, columns, rng)


def _beside(thesis: ThesisFigure | None) -> dict[str, float | str]:
    if thesis is not None:
        return thesis.columns()
    return {
        "thesis_recall": np.nan,
        "thesis_fpr": np.nan,
        "thesis_auc": np.nan,
        "thesis_source": "",
    }
