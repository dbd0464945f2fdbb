"""The asset that writes the report.

A thin shell around ``oracle_pipeline.reporting.html``, which is imported inside the functions, so
that the code location loads without pandas and scikit-learn.
"""

from datetime import timedelta
from functools import partial
from typing import TYPE_CHECKING

import dagster as dg

from assets import thesis_method
from assets.aggregates import aggregate, run_table, windows_of
from assets.feature_dataset import feature_dataset
from assets.oracle_evaluation import oracle_evaluation
from assets.partitions import testbed_of
from assets.record_command import record_command
from assets.webserver.report import REPORT_PATH
from resources.store import RunStore

if TYPE_CHECKING:
    import pandas as pd

FRESH = dg.FreshnessPolicy.time_window(  # tolerates one failed night; evaluated only if enabled
    warn_window=timedelta(hours=36), fail_window=timedelta(hours=60)
)


@aggregate(
    "oracle",
    "jinja",
    "matplotlib",
    deps=[
        feature_dataset,
        thesis_method.clustering_grid_search,
        thesis_method.malicious_rate_report,
        thesis_method.pairwise_report,
        oracle_evaluation,
    ],
    place="report/index.html",
    freshness_policy=FRESH,
)
def oracle_report(context: dg.AssetExecutionContext, store: RunStore) -> dg.MaterializeResult[None]:
    """Write the report, `<root>/report/index.html`, with a page for each run.

    The first screen has the recorded runs, the results, and claims that are not supported yet.
    Below it are detection and alarms; folded sections have integrity checks, detectors and the
    thesis's method. The page of a run has its map, unusual windows, evidence, goals and outcome.
    All links are relative.
    """
    from oracle_pipeline.bags.remote import published
    from oracle_pipeline.evaluation.run_deviations import deviations_of_runs
    from oracle_pipeline.replay.picture import FILM, kept_picture
    from oracle_pipeline.reporting import html, thesis_reports
    from oracle_pipeline.reporting.arrivals_page import summary
    from oracle_pipeline.reporting.run_pages import ShownRuns, write_run_pages
    from oracle_pipeline.reporting.searched import searched
    from oracle_pipeline.reporting.stored_report import Report
    from oracle_pipeline.scoring.kept_verdicts import verdict_rows
    from oracle_pipeline.scoring.measured_runs import MeasuredRuns

    evaluation = Report.load(store.results("oracle_evaluation"))
    testbed = testbed_of(evaluation.tables["runs"]["mode"].iloc[0])
    df = run_table(store, testbed)
    measured = MeasuredRuns.ordered(df, windows_of(store, df))
    deviations = deviations_of_runs(df)
    rows, rate, seed, _ = thesis_method.bootstrap_settings(store)
    page = html.render(
        evaluation=evaluation,
        record=partial(record_command, testbed=testbed),
        grid=Report.load(store.results("clustering_grid_search")),
        rates=Report.load(store.results("malicious_rate_report")),
        pairs=Report.load(store.results("pairwise_report")),
        side_by_side=thesis_reports.side_by_side(
            thesis_method.runs_drawn_from(store), rows, rate, seed
        ),
        storage=_storage(store),
        arrived=summary(arrived) if len(arrived := verdict_rows(store.path)) else "",
        searched=searched(store.path),
        provenance=html.provenance(df),
    )
    html.write_page(page, store.report)
    shown = ShownRuns(
        measured=measured,
        evaluation=evaluation,
        deviations=deviations,
        path=lambda run: store.run(run).path,
        film=FILM,
        manifest=lambda run: store.run(run).manifest(),
        picture=lambda run: kept_picture(store.run(run).path),
    )
    with published(store.run_pages, last="index.html") as folder:
        pages = write_run_pages(shown, folder)
    context.log.info(
        f"Report on {len(df)} runs, and a page for each of {pages}: {store.report}. The UI of "
        f"`make ui` shows it at {REPORT_PATH}/."
    )
    return dg.MaterializeResult(
        metadata={
            "path": dg.MetadataValue.path(str(store.report)),
            "url": dg.MetadataValue.url(f"{REPORT_PATH}/"),
            "bytes": store.report.stat().st_size,
            "runs": len(df),
            "run_pages": pages,
            "headline": str(evaluation.summary["headline"]),
        }
    )


def _storage(store: RunStore) -> "pd.DataFrame":
    """Return storage used and kept on this machine, one row for each mode."""
    import pandas as pd

    from resources.storage.stock import storage_of_modes, take_stock

    return pd.DataFrame(storage_of_modes(take_stock(store.path)) if store.is_local else [])
