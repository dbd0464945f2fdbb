"""The thesis's tables computed from our runs, with its printed values in columns ``thesis_*``.

The functions take a feature table and a generator, and return a DataFrame. An estimate has three
columns, for example ``auc``, ``auc_low`` and ``auc_high`` (`Estimate.of_row`). The tables can be
computed with either variant of the thesis's method, and with both side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.clustering.tree import CRITERIA, LINKAGES
from oracle_pipeline.datasets import DatasetError
from oracle_pipeline.evaluation.clustering_result import ClusteringResult, cluster_and_judge
from oracle_pipeline.evaluation.comparisons import ALL_MODES
from oracle_pipeline.evaluation.variants import CORRECTED, THESIS, FeatureSet, MethodVariant
from oracle_pipeline.reporting import thesis_figures

GRID_THRESHOLDS = (2.0, 4.0)
FEATURE_SETS: tuple[FeatureSet, ...] = ("all", "structural", "contextual")
MALICIOUS_RATES = (0.1, 0.3, 0.5, 0.7, 0.9)


def grid_search_table(
    rows: pd.DataFrame,
    rng: np.random.Generator,
    variant: MethodVariant = CORRECTED,
    thresholds: Sequence[float] = GRID_THRESHOLDS,
) -> pd.DataFrame:
    """Judge every setting of a grid on the same rows (the thesis's table 5.1).

    Rows with the thesis's threshold (2 for Ward, 4 otherwise) have its printed values; the thesis's
    variant has no other rows. Its distances are of unscaled features, so in the corrected variant
    only the ``maxclust`` rows are comparable with the thesis.

    Parameters
    ----------
    rows : DataFrame
        Drawn by the same variant.
    rng : Generator
        Draws the resamples for the intervals.
    variant : MethodVariant
    thresholds : sequence of float
        Numbers of clusters, or distances, in units of the scaled features if the variant scales.
    """
    columns = variant.columns(rows, "all")
    table = []
    for method, criterion, t in product(LINKAGES, CRITERIA, thresholds):
        is_printed = t == thesis_figures.THRESHOLD[method]
        if variant is THESIS and not is_printed:
            continue
        result = cluster_and_judge(rows, columns, rng, method, criterion, t, variant)
        figure = thesis_figures.GRID[method, criterion] if is_printed else None
        setting = {"linkage": method, "criterion": criterion, "t": t}
        table.append(setting | result.columns() | _thesis_columns(figure))
    return pd.DataFrame(table)


@dataclass(frozen=True, eq=False, slots=True)
class Bootstraps:
    """How rows are drawn from distinct runs, and by which variant they are clustered."""

    n: int  # rows of each bootstrap
    malicious_rate: float
    seed: int
    rng: np.random.Generator  # draws the resamples for the intervals
    method: MethodVariant = CORRECTED

    def rows(self, df: pd.DataFrame) -> pd.DataFrame:
        """Draw rows from the usable runs; raises `DatasetError` if there are too few."""
        usable = self.method.whole_runs(df)
        return self.method.draw(usable, self.n, self.malicious_rate, self.seed)

    def result(self, df: pd.DataFrame, features: FeatureSet) -> ClusteringResult:
        """Cluster a bootstrap with the thesis's setting, Ward and two clusters."""
        try:
            rows = self.rows(df)
        except DatasetError as error:
            return ClusteringResult(note=str(error))
        columns = self.method.columns(rows, features)
        return cluster_and_judge(rows, columns, self.rng, variant=self.method)


def malicious_rate_table(df: pd.DataFrame, drawn: Bootstraps) -> pd.DataFrame:
    """Cluster bootstraps with different shares of malicious rows (the thesis's table 6.1)."""
    table = []
    for rate in MALICIOUS_RATES:
        result = replace(drawn, malicious_rate=rate).result(df, "all")
        table.append(
            {"malicious_rate": rate}
            | result.columns()
            | _thesis_columns(thesis_figures.RATES.get(rate))
        )
    return pd.DataFrame(table)


def family_table(df: pd.DataFrame, drawn: Bootstraps) -> pd.DataFrame:
    """Cluster all modes on each set of features (the thesis's sections 6.2 to 6.4)."""
    table = []
    for features in FEATURE_SETS:
        place = {"scope": ALL_MODES, "features": features}
        result = drawn.result(df, features)
        table.append(place | result.columns() | _thesis_columns(thesis_figures.FAMILIES[features]))
    return pd.DataFrame(table)


def pairwise_table(df: pd.DataFrame, drawn: Bootstraps) -> pd.DataFrame:
    """Cluster each attacked mode with its control on each set of features (table 6.2)."""
    table = []
    for control, attacked in PAIRS:
        pair = df[df["mode"].isin([control, attacked])]
        for features in FEATURE_SETS:
            place = {"scope": f"{control} / {attacked}", "features": features}
            figure = thesis_figures.PAIRWISE.get((attacked, features))
            table.append(place | drawn.result(pair, features).columns() | _thesis_columns(figure))
    return pd.DataFrame(table)


def side_by_side_table(df: pd.DataFrame, drawn: Bootstraps) -> pd.DataFrame:
    """Compare each printed result of the thesis with both variants of its method on our runs.

    Returns
    -------
    DataFrame
        One row for each printed result. ``thesis_*`` are printed values, or follow from them.
        ``reproduced_recall``, ``_fpr`` and ``_auc`` are the same for the best cluster of the
        thesis's variant, chosen with labels. ``corrected_tpr`` and ``_fpr`` are of the verdict
        without labels and ``corrected_auc`` of the HAC height, by the corrected variant.
    """
    reproduced, corrected = (
        _printed_results(df, replace(drawn, method=method)) for method in (THESIS, CORRECTED)
    )
    notes = zip(reproduced["note"], corrected["note"], strict=True)
    return pd.concat(
        [
            reproduced[["thesis_source", "experiment"]],
            reproduced[["thesis_recall", "thesis_fpr", "thesis_auc", "thesis_mcc", "thesis_runs"]],
            _renamed(
                reproduced,
                "reproduced",
                recall="recall_best_cluster",
                fpr="fpr_best_cluster",
                auc="balanced_accuracy_best_cluster",
            ),
            reproduced[["mcc_best_cluster", "runs_best_cluster"]].set_axis(
                ["reproduced_mcc", "reproduced_runs"], axis=1
            ),
            _renamed(corrected, "corrected", tpr="tpr", fpr="fpr", auc="auc"),
            corrected[["mcc"]].set_axis(["corrected_mcc"], axis=1),
            pd.Series(["; ".join(dict.fromkeys(filter(None, n))) for n in notes], name="note"),
        ],
        axis=1,
    )


def _printed_results(df: pd.DataFrame, drawn: Bootstraps) -> pd.DataFrame:
    """Return one variant's rows of all tables that are in the thesis."""
    rates = malicious_rate_table(df, drawn)
    families, pairs = family_table(df, drawn), pairwise_table(df, drawn)
    tables = [
        _grid_or_reason(df, drawn),
        rates.assign(experiment=[f"{rate:.0%} malicious" for rate in rates["malicious_rate"]]),
        *(
            table.assign(experiment=table["scope"] + ", " + table["features"])
            for table in (families, pairs)
        ),
    ]
    joined = pd.concat(tables, ignore_index=True)
    return joined[joined["thesis_source"] != ""].reset_index(drop=True)


def _grid_or_reason(df: pd.DataFrame, drawn: Bootstraps) -> pd.DataFrame:
    try:
        rows = drawn.rows(df)
    except DatasetError as error:
        nothing = ClusteringResult(note=str(error)).columns()
        table = pd.DataFrame(
            {"linkage": method, "criterion": criterion} | nothing | figure.columns()
            for (method, criterion), figure in thesis_figures.GRID.items()
        )
    else:
        table = grid_search_table(rows, drawn.rng, drawn.method)
    return table.assign(experiment=table["linkage"] + ", " + table["criterion"])


def _renamed(table: pd.DataFrame, prefix: str, **estimates: str) -> pd.DataFrame:
    """Return estimates with their intervals under new names."""
    ends = ("", "_low", "_high")
    names = {
        f"{old}{end}": f"{prefix}_{new}{end}" for new, old in estimates.items() for end in ends
    }
    return table[list(names)].rename(columns=names)


def _thesis_columns(thesis: thesis_figures.ThesisFigure | None) -> dict[str, float | str]:
    return thesis_figures.NO_FIGURE if thesis is None else thesis.columns()
