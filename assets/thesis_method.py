"""The thesis's method over all runs: draw rows with replacement, cluster them, measure.

Thin wrappers of ``oracle_pipeline.reporting.thesis_reports``, which is imported inside the
functions, so that the code location loads without pandas and scikit-learn.
"""

from typing import TYPE_CHECKING, Literal

import dagster as dg
from pydantic import Field

from assets.aggregates import TestbedConfig, aggregate, keep, run_table
from assets.feature_dataset import feature_dataset
from assets.partitions import testbed_of
from resources.store import RunStore

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.evaluation.variants import VariantName
    from oracle_pipeline.reporting.stored_report import Report

ROWS = "bootstrapped_dataset"


class BootstrapConfig(TestbedConfig):
    """How rows are drawn, here and in the reports downstream; the defaults are the thesis's."""

    rows: int = Field(default=1000, ge=1, description="Rows to draw, with replacement.")
    malicious_rate: float = Field(
        default=0.3, ge=0.0, le=1.0, description="Share of the rows drawn from attacked runs."
    )
    seed: int = Field(default=50, ge=0, description="Seed of the random generator.")
    variant: Literal["corrected", "thesis"] = Field(
        default="corrected",
        description="`corrected`: cluster scaled features, computed as their names say. `thesis`: "
        "cluster the thesis's ten features, unscaled and computed as in its code.",
    )


class GridConfig(dg.Config):
    """Where the trees of the grid are cut; the default is the thesis's."""

    thresholds: list[float] = Field(
        default=[2.0, 4.0],
        description="Numbers of clusters, and distances, at which trees are cut.",
    )


@aggregate("datasets", "pandas", "parquet", deps=[feature_dataset])
def bootstrapped_dataset(config: BootstrapConfig, store: RunStore) -> dg.MaterializeResult[None]:
    """Rows drawn from the runs with replacement, a fixed share of them attacked.

    This is the thesis's dataset. Copies add no information, so all intervals count distinct runs.
    """
    from oracle_pipeline.reporting import thesis_reports

    result = thesis_reports.bootstrapped_dataset(
        _experiments(run_table(store, config.testbed)),
        config.rows,
        config.malicious_rate,
        config.seed,
        config.variant,
    )
    return keep(result, store, ROWS)


@aggregate("thesis_method", "scipy", "scikitlearn", deps=[bootstrapped_dataset])
def clustering_grid_search(config: GridConfig, store: RunStore) -> dg.MaterializeResult[None]:
    """Linkages, criteria and thresholds, side by side with the thesis's table 5.1.

    `pdist`, `linkage` and `fcluster` on scaled features, or in the thesis's variant on unscaled
    ones with its threshold. Each setting has confusion matrix, TPR, FPR, balanced accuracy, MCC and
    the AUC of the continuous HAC height, with intervals.
    """
    from oracle_pipeline.reporting import thesis_reports
    from oracle_pipeline.reporting.stored_report import Report

    dataset = Report.load(store.results(ROWS))
    result = thesis_reports.clustering_grid_search(
        dataset.table, _variant(dataset), config.thresholds
    )
    return keep(result, store, "clustering_grid_search")


@aggregate("thesis_method", "scipy", "scikitlearn", deps=[feature_dataset, bootstrapped_dataset])
def malicious_rate_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Clustering at five shares of attacked rows, beside the thesis's table 6.1.

    Rows are drawn as in `bootstrapped_dataset`: the same number, seed and variant of the method.
    """
    from oracle_pipeline.reporting import thesis_reports

    rows, _, seed, variant = bootstrap_settings(store)
    result = thesis_reports.malicious_rate_report(runs_drawn_from(store), rows, seed, variant)
    return keep(result, store, "malicious_rate_report")


@aggregate("thesis_method", "scipy", "scikitlearn", deps=[feature_dataset, bootstrapped_dataset])
def pairwise_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Each attacked mode against its control, by feature family, beside the thesis's table 6.2.

    Rows are drawn as in `bootstrapped_dataset`: the same number, share, seed and variant.
    """
    from oracle_pipeline.reporting import thesis_reports

    result = thesis_reports.pairwise_report(runs_drawn_from(store), *bootstrap_settings(store))
    return keep(result, store, "pairwise_report")


def runs_drawn_from(store: RunStore) -> "pd.DataFrame":
    """Return the runs that the rows of `bootstrapped_dataset` were drawn from."""
    from oracle_pipeline.reporting.stored_report import Report

    rows = Report.load(store.results(ROWS)).table
    return _experiments(run_table(store, testbed_of(rows["mode"].iloc[0])))


def _experiments(df: "pd.DataFrame") -> "pd.DataFrame":
    """Drop shadow controls and hard negatives, which the thesis does not have."""
    from oracle_pipeline.datasets import is_hard_negative

    return df[(df["label"] != "control") & ~is_hard_negative(df)]


def bootstrap_settings(store: RunStore) -> "tuple[int, float, int, VariantName]":
    """Return rows, malicious rate, seed and variant of `bootstrapped_dataset`."""
    from oracle_pipeline.reporting.stored_report import Report

    dataset = Report.load(store.results(ROWS))
    rows, rate, seed = (dataset.summary[name] for name in ("rows", "malicious_rate", "seed"))
    return int(rows), float(rate), int(seed), _variant(dataset)


def _variant(dataset: "Report") -> "VariantName":
    return "thesis" if dataset.summary["variant"] == "thesis" else "corrected"
