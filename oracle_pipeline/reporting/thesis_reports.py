"""Reports on the thesis's method: from feature tables to a `Report` of tables and facts.

The first four apply one variant of the thesis's method, which draws copies of runs and clusters
them. `side_by_side` compares both variants with the printed results. Tables are built in
``thesis_tables``; our own evaluation is in ``evaluation_report``.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd

from oracle_pipeline.bootstrap import distinct_runs, lacking
from oracle_pipeline.datasets import content_hash, is_malicious
from oracle_pipeline.evaluation.variants import VARIANTS, MethodVariant, VariantName
from oracle_pipeline.reporting import thesis_tables
from oracle_pipeline.reporting.stored_report import Report
from oracle_pipeline.reporting.thesis_tables import Bootstraps

Facts: TypeAlias = dict[str, float | int | str]

ROWS, MALICIOUS_RATE, SEED = 1000, 0.3, 50  # the thesis's bootstrap

THESIS_WARNING = (
    "Copies of the same runs are clustered, and the best cluster is chosen with the labels that it "
    "is then compared with: its recall and AUC do not measure how well attacks are detected."
)


def bootstrapped_dataset(
    df: pd.DataFrame,
    n: int = ROWS,
    malicious_rate: float = MALICIOUS_RATE,
    seed: int = SEED,
    variant: VariantName = "corrected",
) -> Report:
    """Draw rows with replacement; they are the report's table.

    Parameters and errors are those of `oracle_pipeline.bootstrap.bootstrap`, except that a campaign
    with only one class gives rows of that class and a note in the summary. The thesis's variant
    leaves out runs that lack one of its ten features; the summary lists them.
    """
    by = VARIANTS[variant]
    usable = by.whole_runs(df)
    lacks = lacking(usable)
    rate = float(is_malicious(usable).mean()) if lacks else malicious_rate
    rows = by.draw(usable, n, rate, seed)
    runs = distinct_runs(rows)
    summary: Facts = {
        "rows": n,
        "runs": len(runs),
        "malicious_rate": rate,
        "malicious_rows": int(runs.copies[runs.malicious].sum()),
        "malicious_runs": int(runs.malicious.sum()),
        "most_copies_of_a_run": int(runs.copies.max()),
        "seed": seed,
        "left_out": ", ".join(df["run_id"][~df["run_id"].isin(usable["run_id"])]),
        "content_hash": content_hash(rows),
        "note": lacks,
    }
    return Report(rows, summary | _variant_facts(by))


def _variant_facts(variant: MethodVariant) -> Facts:
    """Return the variant of a report and its warning, for a summary."""
    warning = {"warning": THESIS_WARNING} if variant.name == "thesis" else {}
    return {"variant": str(variant.name), **warning}


def clustering_grid_search(
    rows: pd.DataFrame,
    variant: VariantName = "corrected",
    thresholds: Sequence[float] = thesis_tables.GRID_THRESHOLDS,
) -> Report:
    """Cluster the bootstrapped rows with every setting of the grid (the thesis's table 5.1).

    Parameters
    ----------
    rows : DataFrame
        The table of `bootstrapped_dataset`, of the same variant.
    variant : {"corrected", "thesis"}
    thresholds : sequence of float
        Numbers of clusters, or distances.
    """
    by = VARIANTS[variant]
    rng = np.random.default_rng(SEED)
    table = thesis_tables.grid_search_table(rows, rng, by, thresholds)
    summary: Facts = {"settings": len(table), "note": lacking(rows)}
    return Report(table, summary | _variant_facts(by))


def malicious_rate_report(
    df: pd.DataFrame, n: int = ROWS, seed: int = SEED, variant: VariantName = "corrected"
) -> Report:
    """Cluster bootstraps of five malicious rates (the thesis's table 6.1).

    Parameters
    ----------
    df : DataFrame
        Distinct runs.
    n, seed : int
        Of each bootstrap; the seed is also used for the intervals.
    variant : {"corrected", "thesis"}
    """
    by = VARIANTS[variant]
    drawn = Bootstraps(n, MALICIOUS_RATE, seed, np.random.default_rng(seed), by)
    table = thesis_tables.malicious_rate_table(df, drawn)
    summary: Facts = {"rows": n, "seed": seed, "note": lacking(df)}
    return Report(table, summary | _variant_facts(by))


def pairwise_report(
    df: pd.DataFrame,
    n: int = ROWS,
    malicious_rate: float = MALICIOUS_RATE,
    seed: int = SEED,
    variant: VariantName = "corrected",
) -> Report:
    """Cluster all modes and each pair on each set of features (sections 6.2 to 6.4, table 6.2).

    Parameters are those of `bootstrapped_dataset`.
    """
    by = VARIANTS[variant]
    drawn = Bootstraps(n, malicious_rate, seed, np.random.default_rng(seed), by)
    parts = [thesis_tables.family_table(df, drawn), thesis_tables.pairwise_table(df, drawn)]
    table = pd.concat(parts, ignore_index=True)
    summary: Facts = {"rows": n, "malicious_rate": malicious_rate, "seed": seed}
    return Report(table, summary | _variant_facts(by))


def side_by_side(
    df: pd.DataFrame, n: int = ROWS, malicious_rate: float = MALICIOUS_RATE, seed: int = SEED
) -> Report:
    """Compare the printed results of the thesis with both variants of its method on our runs.

    Parameters are those of `bootstrapped_dataset`; the columns are those of
    `oracle_pipeline.reporting.thesis_tables.side_by_side_table`.
    """
    drawn = Bootstraps(n, malicious_rate, seed, np.random.default_rng(seed))
    table = thesis_tables.side_by_side_table(df, drawn)
    summary: Facts = {
        "rows": n,
        "malicious_rate": malicious_rate,
        "seed": seed,
        "note": lacking(df),
        "warning": THESIS_WARNING,
    }
    return Report(table, summary)
