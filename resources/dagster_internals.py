"""The private names of Dagster that we use; only modules of this name import from ``dagster._``.

Some let one step handle many partitions, for which Dagster 1.13 has no public way. The others are
types of the executor, the run launcher and the origin of a run. Tests fail if a Dagster release
changes their behaviour.
"""

import dagster as dg
from dagster._core.definitions.asset_checks.asset_check_evaluation import (
    AssetCheckEvaluationTargetMaterializationData,
)
from dagster._core.definitions.source_asset import SYSTEM_METADATA_KEY_SOURCE_ASSET_OBSERVATION
from dagster._core.execution.context.system import (
    PlanOrchestrationContext as PlanOrchestrationContext,
)
from dagster._core.execution.plan.plan import ExecutionPlan as ExecutionPlan
from dagster._core.execution.retries import RetryMode as RetryMode
from dagster._core.launcher import CheckRunHealthResult as CheckRunHealthResult
from dagster._core.launcher import WorkerStatus as WorkerStatus
from dagster._core.remote_origin import RegisteredCodeLocationOrigin as RegisteredCodeLocationOrigin
from dagster._core.remote_origin import RemoteJobOrigin as RemoteJobOrigin
from dagster._core.remote_origin import RemoteRepositoryOrigin as RemoteRepositoryOrigin


def checked_materialization(
    record: dg.EventLogRecord,
) -> AssetCheckEvaluationTargetMaterializationData:
    """Return the reference from a check's result to the materialization that was checked.

    Dagster sets it only for a step of one partition. Without it, the UI cannot show whether the
    newest materialization of a partition has been checked.
    """
    return AssetCheckEvaluationTargetMaterializationData(
        storage_id=record.storage_id, run_id=record.run_id, timestamp=record.timestamp
    )


def output_without_event(output_name: str) -> dg.Output[None]:
    """Return an output that lets downstream steps start but records no materialization.

    The step has recorded one for each partition already. Omitting the output (``skippable=True``)
    would make Dagster skip the downstream steps.
    """
    return dg.Output(
        None, output_name=output_name, metadata={SYSTEM_METADATA_KEY_SOURCE_ASSET_OBSERVATION: True}
    )
