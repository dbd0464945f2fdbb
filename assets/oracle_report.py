"""The report on everything that was measured.

A thin shell around ``oracle_pipeline.reporting.html``, which is imported inside the functions, so
that the code location loads without pandas and scikit-learn.
"""

from datetime import timedelta
from typing import TYPE_CHECKING

import dagster as dg

from assets import presentation
from assets.aggregates import DATASET, aggregate, run_table, testbed_of, windows_of
from assets.feature_dataset import feature_dataset
from assets.oracle_evaluation import oracle_evaluation
from assets.thesis_method import (
    clustering_grid_search,
    how_rows_were_drawn,
    malicious_rate_report,
    pairwise_report,
    runs_drawn_from,
)
from resources.failures import clear_failures
from resources.store import RunStore
from resources.ui.report import REPORT_PATH

if TYPE_CHECKING:
    import pandas as pd

FRESH = dg.FreshnessPolicy.time_window(  # one night may fail; not evaluated unless switched on
    warn_window=timedelta(hours=36), fail_window=timedelta(hours=60)
)
GHOST = "atc_ghost_static"  # the mode of which the report shows the radar display


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
    """Everything as one self-contained HTML file, `<root>/report/index.html`.

    Detection with integrity checks, curves, alarms, detectors and feature families, one run of each
    attack explained beside its control, and the thesis's method compared with its printed results
    and with results on meaningless labels.
    """
    from oracle_pipeline.datasets import KEYS, read_table
    from oracle_pipeline.reporting import html, thesis_reports
    from oracle_pipeline.reporting.explanation import drawn, explanations
    from oracle_pipeline.reporting.report import Report

    def draw(run: str) -> bytes:
        from oracle_pipeline.replay.picture import kept_picture

        return kept_picture(store.run(run).path)

    with clear_failures():
        evaluation = Report.load(store.results("oracle_evaluation"))
        judged = evaluation.tables["runs"]
        df = run_table(store, testbed_of(judged["mode"].iloc[0]))
        attacked = windows_of(store, df[df["label"] == "malicious"])
        explained = explanations(df, attacked, judged, draw)
        keys = read_table(store.dataset(DATASET), columns=KEYS)
        radar, _ = drawn(_ghost_and_control(keys), draw)
        rows, rate, seed, _ = how_rows_were_drawn(store)
        page = html.render(
            df,
            evaluation=evaluation,
            explained=explained,
            grid=Report.load(store.results("clustering_grid_search")),
            rates=Report.load(store.results("malicious_rate_report")),
            pairs=Report.load(store.results("pairwise_report")),
            side_by_side=thesis_reports.side_by_side(runs_drawn_from(store), rows, rate, seed),
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
            "url": dg.MetadataValue.url(f"{REPORT_PATH}/"),
            "bytes": store.report.stat().st_size,
            "runs": len(df),
            "headline": str(evaluation.summary["headline"]),
            **presentation.pictures(pictures),
        }
    )


def _storage(store: RunStore) -> "pd.DataFrame":
    """Return storage used and kept on this machine, one row for each mode."""
    import pandas as pd

    from resources.storage.stock import storage_of_modes, take_stock

    return pd.DataFrame(storage_of_modes(take_stock(store.path)) if store.is_local else [])


def _ghost_and_control(df: "pd.DataFrame") -> list[str]:
    """Return an air traffic run with a ghost and the same run without; empty if not recorded."""
    from oracle_pipeline.reporting.explanation import counterpart

    sky = df[df["mode"].map(testbed_of) == testbed_of(GHOST)]
    ghosts = sky.loc[sky["mode"] == GHOST, "run_id"]
    pairs = ([ghost, *counterpart(ghost, sky)] for ghost in ghosts)
    return next((pair for pair in pairs if len(pair) > 1), [])
