"""One event for each run, from steps that process many runs.

Dagster 1.13 has no public way to give each partition of a range its own data version or check
result. Steps therefore yield the events of every partition themselves, and then return an output
without an event (``resources.dagster_internals``).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import dagster as dg

from resources.dagster_internals import checked_materialization

Figures = Mapping[str, int | float | str | dg.MetadataValue]

_AT_ONCE = 1000  # partitions in one query; SQLite allows some thousands


class Materialized(NamedTuple):
    """The current state of one partition of an asset."""

    spec: dg.AssetSpec
    data_version: str
    code_version: str
    metadata: Figures


def materializations(
    instance: dg.DagsterInstance, key: dg.MultiPartitionKey, assets: Iterable[Materialized]
) -> Iterator[dg.AssetMaterialization]:
    """Yield the materializations of one partition of some assets, upstream before downstream.

    Their tags are those that Dagster would set. The UI derives from them which partitions are stale
    because code or upstream data have changed. A tag refers to the upstream event, so the caller
    must store each event before requesting the next.
    """
    upstream: dict[dg.AssetKey, dg.EventLogRecord | None] = {}
    for spec, data_version, code_version, metadata in assets:
        tags = {f"dagster/partition/{name}": of for name, of in key.keys_by_dimension.items()}
        tags["dagster/data_version"] = data_version
        tags["dagster/data_version_is_user_provided"] = "true"
        tags["dagster/code_version"] = code_version
        for asset in (dependency.asset_key for dependency in spec.deps):
            if asset not in upstream:
                upstream[asset] = latest_materialization(instance, asset, key)
            name, latest = asset.to_user_string(), upstream[asset]
            upstream_event = latest.asset_materialization if latest else None
            versions = (upstream_event.tags if upstream_event else None) or {}
            version = versions.get("dagster/data_version", "INITIAL")
            tags[f"dagster/input_data_version/{name}"] = version
            tags[f"dagster/input_event_pointer/{name}"] = (
                str(latest.storage_id) if latest else "NULL"
            )
        yield dg.AssetMaterialization(
            asset_key=spec.key, partition=key, metadata=metadata, tags=tags
        )


def latest_materialization(
    instance: dg.DagsterInstance, asset: dg.AssetKey, key: str
) -> dg.EventLogRecord | None:
    """Return the newest materialization of one partition, or None."""
    wanted = dg.AssetRecordsFilter(asset_key=asset, asset_partitions=[key])
    return next(iter(instance.fetch_materializations(wanted, limit=1).records), None)


def latest_materializations(
    instance: dg.DagsterInstance, asset: dg.AssetKey, keys: Sequence[str]
) -> dict[str, dg.EventLogRecord]:
    """Return the newest materialization of each partition that has one, with few queries."""
    latest = {}
    for first in range(0, len(keys), _AT_ONCE):
        some = set(keys[first : first + _AT_ONCE])
        ids = instance.get_latest_storage_id_by_partition(
            asset, dg.DagsterEventType.ASSET_MATERIALIZATION, some
        )
        if ids:
            newest = dg.AssetRecordsFilter(asset_key=asset, storage_ids=list(ids.values()))
            for record in instance.fetch_materializations(newest, limit=len(ids)).records:
                latest[str(record.partition_key)] = record
    return latest


def check_evaluation(
    spec: dg.AssetCheckSpec, key: str, target: dg.EventLogRecord | None, *, passed: bool,
    description: str | None, metadata: Figures,
    severity: dg.AssetCheckSeverity = dg.AssetCheckSeverity.ERROR,
) -> dg.AssetCheckEvaluation:  # fmt: skip
    """Return a check's result for one partition, linked to the checked materialization."""
    return dg.AssetCheckEvaluation(
        asset_key=spec.asset_key, check_name=spec.name, partition=key, passed=passed,
        description=description, metadata=metadata, severity=severity,
        target_materialization_data=checked_materialization(target) if target else None,
    )  # fmt: skip
