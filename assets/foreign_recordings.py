"""Assets for recordings that arrive in a folder: features and verdicts, and a page on all of them.

They are external assets: the job ``judge_arrivals`` reports their events. Dagster rejects commands
and jobs over assets with different partitions. External assets are not part of any selection, so
``--select '*'`` still means the whole campaign.
"""

from collections.abc import Iterator
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
    from oracle_pipeline.bags.arrivals import Arrival
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict

ARRIVALS = dg.DynamicPartitionsDefinition(name="arrivals")
GROUP = "foreign"
_VERDICT_CODE = analysis_code("assets.worker.arrival_verdict")

FOREIGN_FEATURES = dg.AssetSpec(
    "foreign_features",
    group_name=GROUP,
    kinds={"pandas", "parquet"},
    **declared("recording", "foreign/<recording>/run.parquet"),
    code_version=feature_code(),
    partitions_def=ARRIVALS,
    description="""The features of a recording that arrived in the inbox, and of its windows.

`<root>/foreign/<key>/run.parquet` and `window.parquet`, with the columns of `run_features` and
`window_features`. The job `judge_arrivals` writes them, and the sensor `arrived_recordings` starts
the job.""",
)
FOREIGN_VERDICTS = dg.AssetSpec(
    "foreign_verdicts",
    deps=[FOREIGN_FEATURES],
    group_name=GROUP,
    kinds={"oracle", "json"},
    **declared("recording", "foreign/<recording>/verdict.json"),
    code_version=_VERDICT_CODE,
    partitions_def=ARRIVALS,
    description="""The verdict on a recording by the reference card, with its evidence.

`<root>/foreign/<key>/verdict.json`: outcome, p-value, breaches of the contract, features outside
their usual range. The same as `oracle score RECORDING --reference CARD`.""",
)
FOREIGN_REPORT = dg.AssetSpec(
    "foreign_report",
    deps=[FOREIGN_VERDICTS],
    group_name=GROUP,
    kinds={"oracle", "jinja"},
    **declared("campaign", "report/foreign.html"),
    code_version=analysis_code("oracle_pipeline.reporting.arrivals_page"),
    description="""All verdicts on recordings that arrived, as one HTML file, the newest first.

`<root>/report/foreign.html`, beside the report on the campaign, which links to it.""",
)
SPECS = (FOREIGN_FEATURES, FOREIGN_VERDICTS, FOREIGN_REPORT)
IS_NORMAL = dg.AssetCheckSpec(
    "recording_is_normal",
    asset=FOREIGN_VERDICTS.key,
    partitions_def=ARRIVALS,
    description="The recording is not anomalous and breaks no contract. A recording that could not "
    "be judged does not pass; with too few normal recordings for a verdict this is a warning.",
)


class JudgeConfig(dg.Config):
    """The false positive rate of a verdict, and limits for one recording."""

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
def judge_recording(
    context: dg.OpExecutionContext, config: JudgeConfig, store: RunStore, inbox: Inbox
) -> Iterator[dg.AssetMaterialization | dg.AssetCheckEvaluation | dg.Output[None]]:
    """Judge the recording of the partition, and update the page on all recordings."""
    from assets.worker.arrival_verdict import judge_arrival
    from oracle_pipeline.reporting.trend import trend
    from oracle_pipeline.scoring.isolation import Limits

    key = context.partition_key
    store.require_writable()
    with clear_failures():
        arrival = _arrival(inbox, key)
        limits = Limits(config.time_limit, config.memory_limit)
        judged = judge_arrival(arrival, store.path, inbox.card_path, config.far, limits)
        if judged.tables is not None:
            yield _materialized(
                FOREIGN_FEATURES,
                arrival,
                {
                    "path": dg.MetadataValue.path(str(layout.foreign(store.path, key))),
                    "windows": len(judged.tables.windows),
                    "dagster/row_count": len(judged.tables.run),
                    "dagster/column_schema": dg.MetadataValue.table_schema(
                        presentation.columns(judged.tables.run)
                    ),
                },
            )
        yield _materialized(FOREIGN_VERDICTS, arrival, _facts(judged.kept, store))
        target = latest_materialization(context.instance, FOREIGN_VERDICTS.key, key)
        yield _evaluation(judged.kept, target)
        shown = _write_page(store)
    page, scores = layout.foreign_page(store.path), trend(shown)
    context.log.info(
        f"Verdict on {arrival.name}: {judged.kept.verdict.outcome}. All {len(shown)} verdicts "
        f"are in {page}."
    )
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
    description="Judge one recording in the inbox by the reference card: features, verdict, "
    "check, page. The sensor `arrived_recordings` starts it; start it by hand to judge again, for "
    "example with another card.",
)
def judge_arrivals() -> None:
    """Judge one recording."""
    judge_recording()


@dg.multi_asset_check(name="checks_of_arrivals", specs=[IS_NORMAL])
def checks_of_arrivals(
    context: dg.AssetCheckExecutionContext, store: RunStore
) -> Iterator[dg.AssetCheckEvaluation | dg.Output[None]]:
    """Return the check results of all stored verdicts; nothing is judged again."""
    from oracle_pipeline.scoring.kept_verdicts import kept_verdicts

    with clear_failures():
        stored = kept_verdicts(store.path)
    keys = [kept.key for kept in stored]
    targets = latest_materializations(context.instance, FOREIGN_VERDICTS.key, keys)
    for kept in stored:
        yield _evaluation(kept, targets.get(kept.key))
    yield dg.Output(None, output_name=IS_NORMAL.get_python_identifier())


def _arrival(inbox: Inbox, key: str) -> "Arrival":
    from oracle_pipeline.bags.arrivals import arrivals

    found = {arrival.key: arrival for arrival in arrivals(inbox.path).found}
    if key not in found:
        raise dg.Failure(
            f"No recording in {inbox.path} has the key {key}: it was removed or renamed. Put it "
            "back, or delete the partition.",
            allow_retries=False,
        )
    return found[key]


def _materialized(
    spec: dg.AssetSpec, arrival: "Arrival", metadata: Figures
) -> dg.AssetMaterialization:
    return dg.AssetMaterialization(
        spec.key,
        partition=arrival.key,
        metadata={"recording": arrival.name, **metadata},
        tags={"dagster/code_version": str(spec.code_version)},
    )


def _facts(kept: "KeptVerdict", store: RunStore) -> Figures:
    """Return a verdict as metadata, with its evidence as a table."""
    from oracle_pipeline.scoring.output import HEADINGS, cells

    verdict = kept.verdict
    columns = [dg.TableColumn(heading, "string") for heading in HEADINGS]
    rows = [
        dg.TableRecord(dict(zip(HEADINGS, cells(each), strict=True))) for each in verdict.evidence
    ]
    numbers = {"p_value": verdict.p_value, "score": verdict.score}
    return {
        "outcome": verdict.outcome,
        **{name: number for name, number in numbers.items() if number is not None},
        "false_positive_rate": kept.far,
        "card": kept.card,
        "contract": dg.MetadataValue.json(list(verdict.contract)),
        "evidence": dg.MetadataValue.table(rows, schema=dg.TableSchema(columns)),
        "notes": dg.MetadataValue.json([*filter(None, [verdict.error]), *verdict.notes]),
        "path": dg.MetadataValue.path(str(layout.foreign(store.path, kept.key) / layout.VERDICT)),
    }


def _evaluation(kept: "KeptVerdict", target: dg.EventLogRecord | None) -> dg.AssetCheckEvaluation:
    """Return the check's result; too few normal recordings give only a warning."""
    from oracle_pipeline.scoring.output import paragraph

    verdict = kept.verdict
    unsupported = verdict.outcome == "unsupported"
    return check_evaluation(
        IS_NORMAL,
        kept.key,
        target,
        passed=verdict.outcome == "normal",
        description="\n".join(paragraph(verdict)),
        metadata={"outcome": verdict.outcome, "false_positive_rate": kept.far},
        severity=dg.AssetCheckSeverity.WARN if unsupported else dg.AssetCheckSeverity.ERROR,
    )


def _write_page(store: RunStore) -> "list[KeptVerdict]":
    """Write the page on all verdicts, and return these."""
    from oracle_pipeline.reporting.arrivals_page import arrivals_page
    from oracle_pipeline.reporting.html import write_page
    from oracle_pipeline.scoring.kept_verdicts import kept_verdicts

    shown: list[KeptVerdict] | None = None
    while shown != (now := kept_verdicts(store.path)):  # another run may have written meanwhile
        write_page(arrivals_page(now), layout.foreign_page(store.path))
        shown = now
    return shown
