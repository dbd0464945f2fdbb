"""Assets for recordings that arrive in a folder: features and verdicts, and a page on all of them.

They are external assets: the job ``judge_arrivals`` reports their events. Dagster rejects commands
and jobs over assets with different partitions. External assets are not part of any selection, so
``--select '*'`` still means the whole campaign.
"""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.asset_defaults import declared
from assets.events import Figures, check_evaluation, latest_materialization, latest_materializations
from assets.webserver.report import REPORT_PATH
from assets.worker.versions import analysis_code, feature_code
from oracle_pipeline.bags import layout
from resources.failures import clear_failures
from resources.inbox import Inbox
from resources.store import RunStore

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.bags.arrivals import Arrival
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict

ARRIVALS = dg.DynamicPartitionsDefinition(name="arrivals")  # batches, by the time of the request
GROUP = "foreign"
SHOWN = 100  # recordings of a batch, in the UI
_VERDICT_CODE = analysis_code("assets.worker.arrival_verdict")

FOREIGN_FEATURES = dg.AssetSpec(
    "foreign_features",
    group_name=GROUP,
    kinds={"pandas", "parquet"},
    **declared("batch", "foreign/<recording>/run.parquet"),
    code_version=feature_code(),
    partitions_def=ARRIVALS,
    description="""The features of recordings that arrived in the inbox, and of their windows.

`<root>/foreign/<key>/run.parquet` and `window.parquet`, with the columns of `run_features` and
`window_features`. The job `judge_arrivals` writes them, and the sensor `arrived_recordings` starts
the job.""",
)
FOREIGN_VERDICTS = dg.AssetSpec(
    "foreign_verdicts",
    deps=[FOREIGN_FEATURES],
    group_name=GROUP,
    kinds={"oracle", "parquet"},
    **declared("batch", "report/foreign.parquet"),
    code_version=_VERDICT_CODE,
    partitions_def=ARRIVALS,
    description="""The verdicts on recordings by the reference card, with their evidence.

`<root>/foreign/<key>/verdict.json`: outcome, p-value, breaches of the contract, features outside
their usual range. The same as `oracle score RECORDING --reference CARD`. A row of each is in
`<root>/report/foreign.parquet`.""",
)
FOREIGN_REPORT = dg.AssetSpec(
    "foreign_report",
    deps=[FOREIGN_VERDICTS],
    group_name=GROUP,
    kinds={"oracle", "jinja"},
    **declared("campaign", "report/foreign.html"),
    code_version=analysis_code("oracle_pipeline.reporting.arrivals_page"),
    description="""The newest and the most unusual recordings that arrived, and a trend of scores.

`<root>/report/foreign.html`, beside the report on the campaign, which links to it.""",
)
SPECS = (FOREIGN_FEATURES, FOREIGN_VERDICTS, FOREIGN_REPORT)
IS_NORMAL = dg.AssetCheckSpec(
    "recording_is_normal",
    asset=FOREIGN_VERDICTS.key,
    partitions_def=ARRIVALS,
    description="No recording of the batch is anomalous or breaks a contract. One that could not "
    "be judged does not pass; with too few normal recordings for a verdict this is a warning.",
)


class JudgeConfig(dg.Config):
    """Which recordings are judged, the false positive rate, and limits for one recording."""

    recordings: list[str] = Field(
        default=[], description="Keys of the recordings; empty: those that the batch had before."
    )
    far: float = Field(
        default=0.05,
        gt=0.0,
        lt=1.0,
        description="False positive rate: the share of normal recordings that may be called "
        "anomalous.",
    )
    time_limit: float = Field(
        default=900.0, gt=0.0, description="Time that the features of a recording may take [s]."
    )
    memory_limit: float = Field(
        default=4.0, gt=0.0, description="Memory that the features of a recording may take [GiB]."
    )


@dg.op
def judge_recordings(
    context: dg.OpExecutionContext, config: JudgeConfig, store: RunStore, inbox: Inbox
) -> Iterator[dg.AssetMaterialization | dg.AssetCheckEvaluation | dg.Output[None]]:
    """Judge the recordings of a batch, and update the table and the page of all."""
    from oracle_pipeline.reporting.trend import trend

    batch = context.partition_key
    store.require_writable()
    with clear_failures():
        rows, features = _judged(context, config, store, inbox)
        own = rows[rows["batch"] == batch]
        if features:
            yield _materialized(FOREIGN_FEATURES, batch, features)
        yield _materialized(FOREIGN_VERDICTS, batch, _facts(own, inbox, store))
        target = latest_materialization(context.instance, FOREIGN_VERDICTS.key, batch)
        yield _evaluation(store, batch, own, target)
        shown = _write_page(store)
        page, scores = layout.foreign_page(store.path), trend(shown)
    context.log.info(f"{page} shows the newest and the most unusual of {len(shown)} recordings.")
    yield dg.AssetMaterialization(
        FOREIGN_REPORT.key,
        metadata={
            "path": dg.MetadataValue.path(str(page)),
            "url": dg.MetadataValue.url(f"{REPORT_PATH}/{page.name}"),
            "recordings": len(shown),
            **presentation.picture(scores),
        },
        tags={"dagster/code_version": str(FOREIGN_REPORT.code_version)},
    )
    yield dg.Output(None)


@dg.job(
    partitions_def=ARRIVALS,
    description="Judge a batch of recordings in the inbox by the reference card: features, "
    "verdicts, check, page. The sensor `arrived_recordings` starts it; start it by hand to judge "
    "again, for example with another card.",
)
def judge_arrivals() -> None:
    """Judge a batch of recordings."""
    judge_recordings()


@dg.multi_asset_check(name="checks_of_arrivals", specs=[IS_NORMAL])
def checks_of_arrivals(
    context: dg.AssetCheckExecutionContext, store: RunStore
) -> Iterator[dg.AssetCheckEvaluation | dg.Output[None]]:
    """Return the check results of all stored verdicts; nothing is judged again."""
    from oracle_pipeline.scoring.kept_verdicts import verdict_rows

    with clear_failures():
        rows = verdict_rows(store.path)
    batches = {str(batch): own for batch, own in rows.groupby("batch") if batch}
    targets = latest_materializations(context.instance, FOREIGN_VERDICTS.key, list(batches))
    for batch, own in batches.items():
        yield _evaluation(store, batch, own, targets.get(batch))
    yield dg.Output(None, output_name=IS_NORMAL.get_python_identifier())


def _judged(
    context: dg.OpExecutionContext, config: JudgeConfig, store: RunStore, inbox: Inbox
) -> "tuple[pd.DataFrame, Figures]":
    """Judge the recordings of a batch; return the table of all verdicts, and facts on features."""
    from assets.worker.arrival_verdict import judge_each
    from oracle_pipeline.scoring.isolation import Limits
    from oracle_pipeline.scoring.kept_verdicts import add_verdicts

    found = _arrivals(context, config, store, inbox)
    limits = Limits(config.time_limit, config.memory_limit)
    work = judge_each(found, store.path, inbox.card_path, config.far, limits, context.partition_key)
    verdicts: list[KeptVerdict] = []
    features: Figures = {}
    recordings = windows = 0
    try:
        for kept, tables in work:
            verdicts.append(kept)
            context.log.info(
                f"{len(verdicts)} of {len(found)} judged: {kept.verdict.recording} is "
                f"{kept.verdict.outcome}."
            )
            if tables is not None:
                recordings, windows = recordings + 1, windows + len(tables.windows)
                features = {
                    "path": dg.MetadataValue.path(str(store.path / layout.FOREIGN)),
                    "windows": windows,
                    "dagster/row_count": recordings,
                    "dagster/column_schema": dg.MetadataValue.table_schema(
                        presentation.columns(tables.run)
                    ),
                }
    finally:  # what is finished is kept
        rows = add_verdicts(store.path, verdicts)
    return rows, features


def _arrivals(
    context: dg.OpExecutionContext, config: JudgeConfig, store: RunStore, inbox: Inbox
) -> "list[Arrival]":
    """Return the recordings of a batch that are in the inbox."""
    from oracle_pipeline.bags.arrivals import arrivals
    from oracle_pipeline.scoring.kept_verdicts import verdict_rows

    wanted = set(config.recordings)
    if not wanted:
        rows = verdict_rows(store.path)
        wanted = set(rows.loc[rows["batch"] == context.partition_key, "key"])
    found = arrivals(inbox.path, wanted).found
    if gone := ", ".join(sorted(wanted - {each.key for each in found})):
        context.log.warning(f"{inbox.path} has no recording {gone}: removed or renamed.")
    if not found:
        raise dg.Failure(
            f"No recording of this batch is in {inbox.path}: they were removed or renamed. Put "
            "them back, or give other recordings in the configuration.",
            allow_retries=False,
        )
    return found


def _materialized(spec: dg.AssetSpec, batch: str, metadata: Figures) -> dg.AssetMaterialization:
    return dg.AssetMaterialization(
        spec.key,
        partition=batch,
        metadata=metadata,
        tags={"dagster/code_version": str(spec.code_version)},
    )


def _facts(rows: "pd.DataFrame", inbox: Inbox, store: RunStore) -> Figures:
    """Return the verdicts of a batch as metadata, the most unusual first."""
    shown = rows.sort_values("score", ascending=False, kind="stable").head(SHOWN)
    return {
        **{str(outcome): int(n) for outcome, n in rows["outcome"].value_counts().items()},
        "recordings": len(rows),
        "false_positive_rate": float(rows["far"].iloc[-1]),
        "card": str(inbox.card_path),
        "verdicts": presentation.table(shown.drop(columns=["fingerprint", "batch", "far"])),
        "path": dg.MetadataValue.path(str(layout.foreign_rows(store.path))),
    }


def _evaluation(
    store: RunStore, batch: str, rows: "pd.DataFrame", target: dg.EventLogRecord | None
) -> dg.AssetCheckEvaluation:
    """Return the check's result; too few normal recordings give only a warning."""
    from oracle_pipeline.scoring.output import paragraph

    odd = rows[rows["outcome"] != "normal"]
    shown = [_kept(store, key).verdict for key in odd["key"].head(SHOWN)]
    lines = [line for verdict in shown for line in paragraph(verdict)]
    return check_evaluation(
        IS_NORMAL,
        batch,
        target,
        passed=odd.empty,
        description="\n".join(lines) or f"All {len(rows)} are normal.",
        metadata={"recordings": len(rows), "not_normal": len(odd)},
        severity=dg.AssetCheckSeverity.WARN
        if odd["outcome"].eq("unsupported").all()
        else dg.AssetCheckSeverity.ERROR,
    )


def _write_page(store: RunStore) -> "pd.DataFrame":
    """Write the page on all verdicts, and return their table."""
    from oracle_pipeline.reporting.arrivals_page import arrivals_page
    from oracle_pipeline.reporting.html import write_page
    from oracle_pipeline.scoring.kept_verdicts import verdict_rows

    shown: pd.DataFrame | None = None
    # Another run may have written meanwhile.
    while shown is None or not shown.equals(verdict_rows(store.path)):
        shown = verdict_rows(store.path)
        write_page(arrivals_page(shown, partial(_kept, store)), layout.foreign_page(store.path))
    return shown


def _kept(store: RunStore, key: str) -> "KeptVerdict":
    from oracle_pipeline.scoring.kept_verdicts import kept_verdict

    return kept_verdict(layout.foreign(store.path, key) / layout.VERDICT)
