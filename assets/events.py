"""One event a run, from steps that take many runs.

Dagster 1.13 has no public way to give each partition of a range its own data version, or its own
check result. Steps here yield the events of every partition themselves and then hand Dagster an
output without one. The two private names that this takes stand in this module only.
"""

from collections.abc import Mapping

import dagster as dg
from dagster._core.definitions.asset_checks.asset_check_evaluation import (
    AssetCheckEvaluationTargetMaterializationData,
)
from dagster._core.definitions.source_asset import SYSTEM_METADATA_KEY_SOURCE_ASSET_OBSERVATION

Figures = Mapping[str, int | float | str | dg.MetadataValue]


def materialization(
    instance: dg.DagsterInstance,
    spec: dg.AssetSpec,
    key: dg.MultiPartitionKey,
    *,
    data_version: str,
    code_version: str,
    metadata: Figures,
) -> dg.AssetMaterialization:
    """Return the event that turns one partition of an asset green.

    Its tags are those that Dagster itself would give it: from them the UI knows which partitions
    are stale, because of other code or of newer data upstream.
    """
    tags = {f"dagster/partition/{name}": of for name, of in key.keys_by_dimension.items()}
    tags["dagster/data_version"] = data_version
    tags["dagster/data_version_is_user_provided"] = "true"
    tags["dagster/code_version"] = code_version
    for dependency in spec.deps:
        name = dependency.asset_key.to_user_string()
        latest = latest_materialization(instance, dependency.asset_key, key)
        seen = latest.asset_materialization if latest else None
        versions = (seen.tags if seen else None) or {}
        tags[f"dagster/input_data_version/{name}"] = versions.get("dagster/data_version", "INITIAL")
        tags[f"dagster/input_event_pointer/{name}"] = str(latest.storage_id) if latest else "NULL"
    return dg.AssetMaterialization(asset_key=spec.key, partition=key, metadata=metadata, tags=tags)


def latest_materialization(
    instance: dg.DagsterInstance, asset: dg.AssetKey, key: str
) -> dg.EventLogRecord | None:
    """Return the newest materialization of one partition, if there is one."""
    wanted = dg.AssetRecordsFilter(asset_key=asset, asset_partitions=[key])
    return next(iter(instance.fetch_materializations(wanted, limit=1).records), None)


def check_evaluation(
    context: dg.AssetCheckExecutionContext | dg.AssetExecutionContext,
    spec: dg.AssetCheckSpec,
    key: str,
    *,
    passed: bool,
    description: str | None,
    metadata: Figures,
) -> dg.AssetCheckEvaluation:
    """Return a check's result for one partition, tied to what is materialized there now."""
    latest = latest_materialization(context.instance, spec.asset_key, key)
    return dg.AssetCheckEvaluation(
        asset_key=spec.asset_key,
        check_name=spec.name,
        partition=key,
        passed=passed,
        description=description,
        metadata=metadata,
        target_materialization_data=AssetCheckEvaluationTargetMaterializationData(
            storage_id=latest.storage_id,
            run_id=latest.run_id,
            timestamp=latest.timestamp,
        )
        if latest
        else None,
    )


def no_further_event(output_name: str) -> dg.Output[None]:
    """Return the output that lets what is downstream start, without an event of its own."""
    return dg.Output(
        None,
        output_name=output_name,
        metadata={SYSTEM_METADATA_KEY_SOURCE_ASSET_OBSERVATION: True},
    )
