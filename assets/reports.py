"""The assets over all runs: the dataset, the thesis's clustering, our evaluation, the report.

Thin shells: the work is done in ``oracle_pipeline.datasets`` and ``oracle_pipeline.reporting``,
which are imported inside, so that the code location loads without pandas and scikit-learn. What
they read is what the campaign's partitions left on disk, however many runs that is.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.common import OWNERS, SINGLE_RUN
from assets.feature_tables import feature_table
from assets.partitions import RUNS
from assets.versions import analysis_code
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.failures import clear_failures
from resources.store import RunStore
from sim.modes import PAIRS, modes

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.reporting.result import Report

DATASET, ROWS = "features", "bootstrapped_dataset"
# Pairs in the order in which they make good pictures: those with an object to see first.
SHOWN_FIRST = sorted(PAIRS, key=lambda pair: modes()[pair[1]].operation != "fake_object")
RUN_FEATURES = dg.AssetDep("run_features", partition_mapping=dg.AllPartitionMapping())


class BootstrapConfig(dg.Config):
    """How rows are drawn; the defaults are the thesis's."""

    rows: int = Field(default=1000, ge=1, description="Rows to draw, with replacement.")
    malicious_rate: float = Field(
        default=0.3, ge=0.0, le=1.0, description="Share of the rows drawn from attacked runs."
    )
    seed: int = Field(default=50, ge=0, description="Of the generator that draws.")


def _aggregate(
    group: str, *kinds: str, deps: list[dg.AssetDep | dg.AssetsDefinition]
) -> Callable[[Callable[..., Any]], dg.AssetsDefinition]:
    """Decorate an asset over all runs."""
    return dg.asset(
        deps=deps,
        group_name=group,
        kinds=set(kinds),
        owners=OWNERS,
        code_version=analysis_code(),
        backfill_policy=SINGLE_RUN,
    )


@_aggregate("datasets", "pandas", "parquet", deps=[RUN_FEATURES])
def feature_dataset(store: RunStore) -> dg.MaterializeResult[None]:
    """All runs as one table: a row a run, a column a feature.

    Joins the run features that are on disk for the modes and runs of the partitions, and refuses
    tables of different columns or units. Left out are runs that were over before the node of a
    delayed mode appeared. `oracle score --reference` takes this file.
    """
    from oracle_pipeline import datasets

    runs = [store.run(key) for key in RUNS.get_partition_keys()]
    extracted = [run for run in runs if feature_table(run, "run").is_file()]
    with clear_failures():
        too_short = {run.key for run in extracted if not _reached_its_onset(run)}
        tables = [feature_table(run, "run") for run in extracted if run.key not in too_short]
        df = datasets.feature_dataset([datasets.read_table(table) for table in tables])
        datasets.write_table(df, store.dataset(DATASET))
    runs_of_mode = df.groupby("mode", sort=False).size()
    return dg.MaterializeResult(
        data_version=dg.DataVersion(datasets.content_hash(df)),
        metadata={
            "runs": len(df),
            "left_out": ", ".join(sorted(too_short)),
            "malicious_runs": int(datasets.is_malicious(df).sum()),
            "features": len(datasets.feature_columns(df)),
            "runs_of_mode": {str(mode): int(runs) for mode, runs in runs_of_mode.items()},
            "path": dg.MetadataValue.path(store.dataset(DATASET)),
            "dagster/row_count": len(df),
            "dagster/column_schema": presentation.columns(df),
        },
    )


def _reached_its_onset(run: RunDirectory) -> bool:
    """Tell whether the mode's node was ever there; features outlive a run that was removed."""
    return not run.is_complete() or run.manifest().onset_s is not None


@_aggregate("datasets", "pandas", "parquet", deps=[feature_dataset])
def bootstrapped_dataset(config: BootstrapConfig, store: RunStore) -> dg.MaterializeResult[None]:
    """Rows drawn from the runs with replacement, a fixed share of them attacked.

    The thesis's dataset. Copies add no information: every figure made from it counts the distinct
    runs behind them.
    """
    from oracle_pipeline.reporting import reports

    with clear_failures():
        result = reports.bootstrapped_dataset(
            _dataset(store), config.rows, config.malicious_rate, config.seed
        )
        return _keep(result, store, ROWS)


@_aggregate("thesis_method", "scipy", "scikitlearn", deps=[bootstrapped_dataset])
def clustering_grid_search(store: RunStore) -> dg.MaterializeResult[None]:
    """Four linkages, two criteria, two thresholds, side by side with the thesis's table 5.1.

    `pdist`, `linkage`, `fcluster` on scaled features. For each: confusion matrix, TPR, FPR,
    balanced accuracy, MCC and the AUC of the continuous HAC height, with intervals.
    """
    from oracle_pipeline.reporting import reports
    from oracle_pipeline.reporting.result import Report

    with clear_failures():
        rows = Report.load(store.results(ROWS)).table
        return _keep(reports.clustering_grid_search(rows), store, "clustering_grid_search")


@_aggregate("thesis_method", "scipy", "scikitlearn", deps=[feature_dataset, bootstrapped_dataset])
def malicious_rate_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Clustering at five shares of attacked rows, beside the thesis's table 6.1.

    Each share is drawn from the runs as `bootstrapped_dataset` was: as many rows, same seed.
    """
    from oracle_pipeline.reporting import reports

    with clear_failures():
        rows, _, seed = _how_rows_were_drawn(store)
        result = reports.malicious_rate_report(_dataset(store), rows, seed)
        return _keep(result, store, "malicious_rate_report")


@_aggregate("thesis_method", "scipy", "scikitlearn", deps=[feature_dataset, bootstrapped_dataset])
def pairwise_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Each attacked mode against its control, by feature family, beside the thesis's table 6.2.

    Each pair is drawn as `bootstrapped_dataset` was: as many rows, same share, same seed.
    """
    from oracle_pipeline.reporting import reports

    with clear_failures():
        result = reports.pairwise_report(_dataset(store), *_how_rows_were_drawn(store))
        return _keep(result, store, "pairwise_report")


@_aggregate("oracle", "scikitlearn", deps=[feature_dataset])
def oracle_evaluation(store: RunStore) -> dg.MaterializeResult[None]:
    """Continuous scores on distinct runs: nothing is duplicated before it is clustered."""
    from oracle_pipeline.reporting import reports

    with clear_failures():
        return _keep(reports.oracle_evaluation(_dataset(store)), store, "oracle_evaluation")


@_aggregate(
    "oracle",
    "jinja",
    "matplotlib",
    deps=[
        feature_dataset,
        clustering_grid_search,
        malicious_rate_report,
        pairwise_report,
        oracle_evaluation,
    ],
)
def oracle_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Report for people: one self-contained HTML file, `<root>/report/index.html`.

    What the runs support and what they do not, the thesis's tables beside ours, dendrograms, ROC
    curves, and an attacked run with its control from above.
    """
    from oracle_pipeline.reporting import html
    from oracle_pipeline.reporting.result import Report
    from oracle_pipeline.reporting.run_picture import kept_picture

    with clear_failures():
        df = _dataset(store)
        pictures = {key: kept_picture(store.run(key).path) for key in _shown_runs(df)}
        evaluation = Report.load(store.results("oracle_evaluation"))
        page = html.render(
            df,
            grid=Report.load(store.results("clustering_grid_search")),
            rates=Report.load(store.results("malicious_rate_report")),
            pairs=Report.load(store.results("pairwise_report")),
            evaluation=evaluation,
            runs=pictures,
            provenance=html.provenance(df),
        )
        html.write_page(page, store.report)
    return dg.MaterializeResult(
        metadata={
            "path": dg.MetadataValue.path(store.report),
            "url": dg.MetadataValue.url(store.report.as_uri()),
            "bytes": store.report.stat().st_size,
            "runs": len(df),
            "headline": str(evaluation.summary["headline"]),
            **presentation.pictures(pictures),
        }
    )


def _shown_runs(df: "pd.DataFrame") -> list[str]:
    """Return a run with an object that is not there and its control, or what comes nearest."""
    present = set(df["run_id"])
    blocks = sorted({key.split("|")[1] for key in present})
    pairs = [(f"{c}|{run}", f"{a}|{run}") for c, a in SHOWN_FIRST for run in blocks]
    return list(next((pair for pair in pairs if present.issuperset(pair)), sorted(present)[:1]))


def _dataset(store: RunStore) -> "pd.DataFrame":
    from oracle_pipeline.datasets import read_table

    return read_table(store.dataset(DATASET))


def _how_rows_were_drawn(store: RunStore) -> tuple[int, float, int]:
    """Return rows, malicious rate and seed of `bootstrapped_dataset`."""
    from oracle_pipeline.reporting.result import Report

    drawn = Report.load(store.results(ROWS)).summary
    rows = int(drawn["rows"])
    return rows, int(drawn["malicious_rows"]) / rows, int(drawn["seed"])


def _keep(result: "Report", store: RunStore, name: str) -> dg.MaterializeResult[None]:
    """Save a report where `oracle_report` finds it, and show it."""
    from oracle_pipeline.datasets import content_hash

    place = store.results(name)
    result.save(place)
    return dg.MaterializeResult(
        data_version=dg.DataVersion(content_hash(result.table)),
        metadata={**presentation.report(result), "path": dg.MetadataValue.path(place)},
    )
