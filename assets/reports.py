"""The thesis's clustering over all runs, and the report on everything.

Thin shells: the work is done in ``oracle_pipeline.reporting``, which is imported inside, so that
the code location loads without pandas and scikit-learn. The tables that they read are made in
``assets.datasets``, our own evaluation in ``assets.evaluation``.
"""

from datetime import timedelta
from typing import TYPE_CHECKING, Literal

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.aggregates import (
    DATASET,
    TestbedConfig,
    aggregate,
    keep,
    run_table,
    windows_of,
)
from assets.datasets import feature_dataset
from assets.evaluation import oracle_evaluation
from resources.failures import clear_failures
from resources.store import RunStore
from sim.modes import modes
from sim.testbeds import which_testbed

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.evaluation.variants import VariantName
    from oracle_pipeline.reporting.result import Report

ROWS = "bootstrapped_dataset"
FRESH = dg.FreshnessPolicy.time_window(  # one night may fail; nobody looks unless it is switched on
    warn_window=timedelta(hours=36), fail_window=timedelta(hours=60)
)
GHOST = "atc_ghost_static"  # the mode of which the report shows the radar display


class BootstrapConfig(TestbedConfig):
    """How rows are drawn, here and in the reports made after it; sizes are the thesis's."""

    rows: int = Field(default=1000, ge=1, description="Rows to draw, with replacement.")
    malicious_rate: float = Field(
        default=0.3, ge=0.0, le=1.0, description="Share of the rows drawn from attacked runs."
    )
    seed: int = Field(default=50, ge=0, description="Of the generator that draws.")
    variant: Literal["corrected", "thesis"] = Field(
        default="corrected",
        description="Cluster scaled features as their names promise them, or, as the thesis's code "
        "does, its own ten numbers without scales.",
    )


@aggregate("datasets", "pandas", "parquet", deps=[feature_dataset])
def bootstrapped_dataset(config: BootstrapConfig, store: RunStore) -> dg.MaterializeResult[None]:
    """Rows drawn from the runs with replacement, a fixed share of them attacked.

    The thesis's dataset. Copies add no information: every figure made from it counts the distinct
    runs behind them.
    """
    from oracle_pipeline.reporting import thesis_reports

    with clear_failures():
        result = thesis_reports.bootstrapped_dataset(
            _experiments(run_table(store, config.testbed)),
            config.rows,
            config.malicious_rate,
            config.seed,
            config.variant,
        )
        return keep(result, store, ROWS)


@aggregate("thesis_method", "scipy", "scikitlearn", deps=[bootstrapped_dataset])
def clustering_grid_search(store: RunStore) -> dg.MaterializeResult[None]:
    """Four linkages, two criteria, two thresholds, side by side with the thesis's table 5.1.

    `pdist`, `linkage`, `fcluster` on scaled features; in the thesis's variant on its unscaled ones,
    at its own threshold. For each: confusion matrix, TPR, FPR, balanced accuracy, MCC and the AUC
    of the continuous HAC height, with intervals.
    """
    from oracle_pipeline.reporting import thesis_reports
    from oracle_pipeline.reporting.result import Report

    with clear_failures():
        drawn = Report.load(store.results(ROWS))
        result = thesis_reports.clustering_grid_search(drawn.table, variant=_variant(drawn))
        return keep(result, store, "clustering_grid_search")


@aggregate("thesis_method", "scipy", "scikitlearn", deps=[feature_dataset, bootstrapped_dataset])
def malicious_rate_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Clustering at five shares of attacked rows, beside the thesis's table 6.1.

    Each share is drawn from the runs as `bootstrapped_dataset` was: as many rows, same seed, same
    variant of the method.
    """
    from oracle_pipeline.reporting import thesis_reports

    with clear_failures():
        rows, _, seed, variant = _how_rows_were_drawn(store)
        result = thesis_reports.malicious_rate_report(_drawn_from(store), rows, seed, variant)
        return keep(result, store, "malicious_rate_report")


@aggregate("thesis_method", "scipy", "scikitlearn", deps=[feature_dataset, bootstrapped_dataset])
def pairwise_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Each attacked mode against its control, by feature family, beside the thesis's table 6.2.

    Each pair is drawn as `bootstrapped_dataset` was: as many rows, same share, same seed, same
    variant of the method.
    """
    from oracle_pipeline.reporting import thesis_reports

    with clear_failures():
        result = thesis_reports.pairwise_report(_drawn_from(store), *_how_rows_were_drawn(store))
        return keep(result, store, "pairwise_report")


@aggregate(
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
    freshness_policy=FRESH,
)
def oracle_report(store: RunStore) -> dg.MaterializeResult[None]:
    """Report for people: one self-contained HTML file, `<root>/report/index.html`.

    What is detected and whether that can be believed, curves, alarms, detectors and families, a run
    of each attack explained beside its control, and the thesis's method side by side with what it
    prints and with what it makes of labels without meaning.
    """
    from oracle_pipeline.datasets import KEYS, read_table
    from oracle_pipeline.reporting import html, thesis_reports
    from oracle_pipeline.reporting.explanation import drawn, explanations
    from oracle_pipeline.reporting.result import Report

    def draw(run: str) -> bytes:
        from oracle_pipeline.replay.picture import kept_picture

        return kept_picture(store.run(run).path)

    with clear_failures():
        evaluation = Report.load(store.results("oracle_evaluation"))
        judged = evaluation.tables["runs"]
        df = run_table(store, _testbed(judged["mode"].iloc[0]))
        attacked = windows_of(store, df[df["label"] == "malicious"])
        explained = explanations(df, attacked, judged, draw)
        keys = read_table(store.dataset(DATASET), columns=KEYS)
        radar, _ = drawn(_ghost_and_control(keys), draw)
        rows, rate, seed, _ = _how_rows_were_drawn(store)
        page = html.render(
            df,
            evaluation=evaluation,
            explained=explained,
            grid=Report.load(store.results("clustering_grid_search")),
            rates=Report.load(store.results("malicious_rate_report")),
            pairs=Report.load(store.results("pairwise_report")),
            side_by_side=thesis_reports.side_by_side(_drawn_from(store), rows, rate, seed),
            null_model=thesis_reports.null_model(seed=seed),
            radar=radar,
            storage=_storage(store),
            provenance=html.provenance(df),
        )
        html.write_page(page, store.report)
    pictures = {run: png for each in explained for run, png in each.pictures.items()}
    return dg.MaterializeResult(
        metadata={
            "path": dg.MetadataValue.path(str(store.report)),
            "url": dg.MetadataValue.url(store.report.as_uri()),
            "bytes": store.report.stat().st_size,
            "runs": len(df),
            "headline": str(evaluation.summary["headline"]),
            **presentation.pictures(pictures),
        }
    )


def _storage(store: RunStore) -> "pd.DataFrame":
    """Return what runs take on this machine and what was kept of them, a row a mode."""
    import pandas as pd

    from resources.storage.stock import storage_of_modes, take_stock

    return pd.DataFrame(storage_of_modes(take_stock(store.path)) if store.is_local else [])


def _ghost_and_control(df: "pd.DataFrame") -> list[str]:
    """Return an air traffic run with a ghost and the same run without; nothing if there is none."""
    from oracle_pipeline.reporting.explanation import counterpart

    sky = df[df["mode"].map(_testbed) == _testbed(GHOST)]
    ghosts = sky.loc[sky["mode"] == GHOST, "run_id"]
    pairs = ([ghost, *counterpart(ghost, sky)] for ghost in ghosts)
    return next((pair for pair in pairs if len(pair) > 1), [])


def _testbed(mode: str) -> str:
    """Return the name of the testbed that a mode is run on."""
    return which_testbed(modes()[mode].scenario)


def _drawn_from(store: RunStore) -> "pd.DataFrame":
    """Return the runs that the rows of `bootstrapped_dataset` were drawn from."""
    from oracle_pipeline.reporting.result import Report

    drawn = Report.load(store.results(ROWS)).table
    return _experiments(run_table(store, _testbed(drawn["mode"].iloc[0])))


def _experiments(df: "pd.DataFrame") -> "pd.DataFrame":
    """Leave out what the thesis has not: shadow controls and hard negatives."""
    from oracle_pipeline.datasets import is_hard_negative

    return df[(df["label"] != "control") & ~is_hard_negative(df)]


def _how_rows_were_drawn(store: RunStore) -> "tuple[int, float, int, VariantName]":
    """Return rows, malicious rate, seed and variant of `bootstrapped_dataset`."""
    from oracle_pipeline.reporting.result import Report

    drawn = Report.load(store.results(ROWS))
    rows, rate, seed = (drawn.summary[name] for name in ("rows", "malicious_rate", "seed"))
    return int(rows), float(rate), int(seed), _variant(drawn)


def _variant(drawn: "Report") -> "VariantName":
    return "thesis" if drawn.summary["variant"] == "thesis" else "corrected"
