"""One function a report: from feature tables to a `Report` of table, pictures and facts.

The first four follow the thesis's method, which draws copies of runs before it clusters them;
`oracle_evaluation` is ours and takes each run once. Tables are made in
``oracle_pipeline.reporting.tables``, pictures in ``oracle_pipeline.reporting.figures``.
"""

import numpy as np
import pandas as pd

from oracle_pipeline.clustering.scores import hac_height
from oracle_pipeline.clustering.tree import LINKAGES, ClusteringError, grow_tree
from oracle_pipeline.datasets import (
    PAIRS,
    DatasetError,
    bootstrap,
    content_hash,
    distinct_runs,
    feature_columns,
    feature_families,
    is_malicious,
    lacking,
)
from oracle_pipeline.evaluation.clustering import scale_rows
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.held_out import held_out_heights
from oracle_pipeline.evaluation.metrics import RocCurve, auc, roc_curve
from oracle_pipeline.reporting import figures, tables
from oracle_pipeline.reporting.result import Report, facts
from oracle_pipeline.reporting.tables import estimate
from oracle_pipeline.reporting.thesis_figures import ALL_FAMILIES

ROWS, MALICIOUS_RATE, SEED = 1000, 0.3, 50  # the thesis's bootstrap


def bootstrapped_dataset(
    df: pd.DataFrame, n: int = ROWS, malicious_rate: float = MALICIOUS_RATE, seed: int = SEED
) -> Report:
    """Draw rows with replacement; the report's table holds them.

    Parameters and errors are those of `oracle_pipeline.datasets.bootstrap`; but of a campaign that
    has only one class so far, all rows are drawn from that one, and the summary says so.
    """
    lacks = lacking(df)
    rate = float(is_malicious(df).mean()) if lacks else malicious_rate
    rows = bootstrap(df, n, rate, seed)
    runs = distinct_runs(rows)
    drawn = rows.iloc[runs.first]
    X = scale_rows(drawn, feature_columns(rows, ALL_FAMILIES))
    picture = figures.principal_components(X, list(drawn["label"]), runs.copies)
    summary: dict[str, float | int | str] = {
        "rows": n,
        "runs": len(runs),
        "malicious_rows": int(runs.copies[runs.malicious].sum()),
        "malicious_runs": int(runs.malicious.sum()),
        "most_copies_of_a_run": int(runs.copies.max()),
        "seed": seed,
        "content_hash": content_hash(rows),
        "note": lacks,
    }
    return Report(rows, {"principal_components": picture}, summary)


def clustering_grid_search(rows: pd.DataFrame, seed: int = SEED) -> Report:
    """Cluster the bootstrapped rows with every setting of the grid (the thesis's table 5.1).

    Parameters
    ----------
    rows : DataFrame
        The table of `bootstrapped_dataset`.
    seed : int
        Of the resamples behind the intervals.

    Raises
    ------
    ClusteringError
        The rows cannot be clustered at all.
    """
    rng = np.random.default_rng(seed)
    table = tables.grid_search_table(rows, rng)
    X, runs = scale_rows(rows, feature_columns(rows, ALL_FAMILIES)), distinct_runs(rows)
    pictures = {"grid": figures.grid_heat_map(table)}
    curves: dict[str, tuple[RocCurve, Estimate]] = {}
    for method in LINKAGES:
        tree = grow_tree(X, method)
        pictures[f"dendrogram_{method}"] = figures.dendrogram(tree, list(rows["label"]))
        if not lacking(rows):
            height = hac_height(tree)[runs.first]
            curves[method] = (roc_curve(height, runs, rng), auc(height, runs, rng))
    if curves:
        pictures["roc"] = figures.roc_curves(curves)
    summary: dict[str, float | int | str] = {"settings": len(table), "note": lacking(rows)}
    return Report(table, pictures, summary | _thesis_choice(table))


def _thesis_choice(table: pd.DataFrame) -> dict[str, float | int | str]:
    """Return the setting that the thesis's rule picks, by recall alone, and what it costs."""
    if table["recall_best_cluster"].isna().all():
        return {}
    chosen = table.iloc[int(table["recall_best_cluster"].argmax())]
    picked = f"{chosen['linkage']}, {chosen['criterion']} {chosen['t']:g}"
    return {
        "thesis_rule_picks": picked,
        **facts("recall_best_cluster", estimate(chosen, "recall_best_cluster")),
        **facts("fpr_best_cluster", estimate(chosen, "fpr_best_cluster")),
    }


def malicious_rate_report(df: pd.DataFrame, n: int = ROWS, seed: int = SEED) -> Report:
    """Cluster bootstraps of five malicious rates (the thesis's table 6.1).

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    n, seed : int
        Of each bootstrap; the seed is that of the intervals too.
    """
    table = tables.malicious_rate_table(df, n, seed, np.random.default_rng(seed))
    ours, thesis = {}, {}
    for _, row in table.iterrows():
        for name, figure in (("recall", "recall"), ("false alarms", "fpr")):
            line = f"{row['malicious_rate']:.0%} malicious, {name}"
            ours[line] = estimate(row, f"{figure}_best_cluster")
            thesis[line] = row[f"thesis_{figure}"]
    picture = figures.intervals(ours, thesis, "share of rows in the best cluster", chance=None)
    return Report(table, {"rates": picture}, {"rows": n, "seed": seed, "note": lacking(df)})


def pairwise_report(
    df: pd.DataFrame, n: int = ROWS, malicious_rate: float = MALICIOUS_RATE, seed: int = SEED
) -> Report:
    """Cluster all modes and each pair on each set of features (sections 6.2 to 6.4, table 6.2).

    Parameters are those of `bootstrapped_dataset`.
    """
    rng = np.random.default_rng(seed)
    settings = (n, malicious_rate, seed, rng)
    parts = [tables.family_table(df, *settings), tables.pairwise_table(df, *settings)]
    table = pd.concat(parts, ignore_index=True)
    ours = {
        _line(row): estimate(row, "balanced_accuracy_best_cluster") for _, row in table.iterrows()
    }
    thesis = {_line(row): row["thesis_auc"] for _, row in table.iterrows()}
    picture = figures.intervals(ours, thesis, "AUC of the best cluster's hard verdict")
    pictures = {"pairs": picture} | _pair_dendrograms(df, n, malicious_rate, seed)
    return Report(table, pictures, {"rows": n, "malicious_rate": malicious_rate, "seed": seed})


def _line(row: pd.Series) -> str:
    """Name a row of a chart by the attacked mode, which implies its control."""
    return f"{row['scope'].split(' / ')[-1]}, {row['features']}"


def _pair_dendrograms(
    df: pd.DataFrame, n: int, malicious_rate: float, seed: int
) -> dict[str, bytes]:
    """Draw the tree of each pair that can be clustered, all features."""
    pictures = {}
    for control, attacked in PAIRS:
        try:
            rows = bootstrap(df[df["mode"].isin([control, attacked])], n, malicious_rate, seed)
            tree = grow_tree(scale_rows(rows, feature_columns(df, ALL_FAMILIES)))
        except (ClusteringError, DatasetError):
            continue  # its row in the table says why
        pictures[f"dendrogram_{attacked}"] = figures.dendrogram(tree, list(rows["label"]))
    return pictures


def oracle_evaluation(df: pd.DataFrame, seed: int = SEED) -> Report:
    """Judge continuous scores by feature family, each run taken once.

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    seed : int
        Of the resamples behind the intervals.
    """
    rng = np.random.default_rng(seed)
    table = tables.evaluation_table(df, rng)
    ours = {_line(row): estimate(row, "auc") for _, row in table.iterrows()}
    pictures = {
        "aucs": figures.intervals(ours, {}, "AUC of the held-out HAC height"),
        "principal_components": figures.principal_components(
            scale_rows(df, feature_columns(df)), list(df["label"])
        ),
    }
    if curves := _family_curves(df, rng):
        pictures["roc"] = figures.roc_curves(curves)
    area = estimate(table.iloc[0], "auc")  # all modes, all features
    runs = distinct_runs(df)
    summary = {
        "headline": headline(area),
        "malicious_runs": int(runs.malicious.sum()),
        "right_runs": int((~runs.malicious).sum()),
        "blocks": len(np.unique(runs.block)),
        "seed": seed,
        "content_hash": content_hash(df),
        **facts("auc", area),
    }
    return Report(table, pictures, summary)


def _family_curves(
    df: pd.DataFrame, rng: np.random.Generator
) -> dict[str, tuple[RocCurve, Estimate]]:
    """Return the held-out HAC height's ROC curve and AUC over all modes, by family."""
    runs, curves = distinct_runs(df), {}
    for family in feature_families(df):
        height = held_out_heights(df, feature_columns(df, [family]))[runs.first]
        area = auc(height, runs, rng)
        if np.isfinite(area.value):
            curves[family] = (roc_curve(height, runs, rng), area)
    return curves


def headline(area: Estimate) -> str:
    """Say in words what an AUC with its interval supports, and no more.

    Examples
    --------
    >>> headline(Estimate(0.55, 0.41, 0.68))
    'Attacked and right runs cannot be told apart: AUC 0.55 [0.41, 0.68] holds 0.5, or chance.'
    """
    if np.isnan(area.value):
        return "Nothing could be measured; the notes say why."
    if area.covers(0.5):
        return f"Attacked and right runs cannot be told apart: AUC {area} holds 0.5, or chance."
    if area.high < 0.5:
        return f"Attacked runs look more ordinary than right ones: AUC {area}, below chance."
    if area.low < 0.85:
        return f"Attacked runs stand out, but not reliably: AUC {area}, above chance."
    return f"Attacked runs stand out clearly: AUC {area}."
