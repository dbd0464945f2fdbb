"""The tables over all recorded runs that are partitions."""

import dagster as dg

from assets import presentation
from assets.aggregates import DATASET, TRUTH, WINDOWS, aggregate
from assets.partitions import RUNS
from oracle_pipeline.bags import layout
from resources.store import RunStore

FEATURES_OF_RUNS = [
    dg.AssetDep(table, partition_mapping=dg.AllPartitionMapping())
    for table in ("run_features", "window_features")
]


@aggregate(
    "datasets", "pandas", "parquet", deps=FEATURES_OF_RUNS, place="datasets/features.parquet"
)
def feature_dataset(
    context: dg.AssetExecutionContext, store: RunStore
) -> dg.MaterializeResult[None]:
    """All runs as one table: one row for each run, one column for each feature.

    Joins the feature tables that are on disk and refuses tables with different columns or units.
    Runs of a delayed mode that ended before its node started are left out. Written to
    `<root>/datasets/features.parquet`, which `oracle score --reference` takes. Beside it,
    `windows.parquet` has one row for each window, and `truth.parquet` holds the ground truth of
    each run, which only the evaluation reads.
    """
    from assets.worker.kept_tables import kept_tables, read_tables
    from oracle_pipeline import datasets
    from oracle_pipeline.evaluation.truth import truth_table

    # In a bucket, asking for each possible run takes long: one listing tells the modes with any.
    modes = {table.parent.name for table in layout.feature_tables(store.path, "run")}
    runs = [run for key in RUNS.get_partition_keys() for run in store.runs(key)]
    extracted = [run for run in runs if run.mode in modes and kept_tables(run)]
    manifests = {run.key: run.manifest() for run in extracted if run.is_complete()}
    too_short = sorted(key for key, manifest in manifests.items() if manifest.onset_s is None)
    joined = [run for run in extracted if run.key not in too_short]
    df = datasets.feature_dataset(read_tables(joined, "run"))
    windows = datasets.window_dataset(read_tables(joined, "window"))
    datasets.write_table(df, store.dataset(DATASET))
    datasets.write_table(windows, store.dataset(WINDOWS))
    datasets.write_table(truth_table(manifests.values()), store.dataset(TRUTH))
    runs_of_mode = df.groupby("mode", sort=False).size()
    context.log.info(
        f"Joined {len(df)} runs of {len(runs_of_mode)} modes, with {len(windows)} windows, in "
        f"{store.dataset(DATASET)}. `oracle score --reference` takes this table."
    )
    if too_short:
        context.log.warning(
            f"Left out {len(too_short)} runs that ended before their node started: "
            f"{', '.join(too_short)}."
        )
    return dg.MaterializeResult(
        data_version=dg.DataVersion(datasets.content_hash(df)),
        metadata={
            "runs": len(df),
            "windows": len(windows),
            "left_out": ", ".join(too_short),
            "malicious_runs": int(datasets.is_malicious(df).sum()),
            "features": len(datasets.feature_columns(df)),
            "runs_of_mode": {str(mode): int(runs) for mode, runs in runs_of_mode.items()},
            "path": dg.MetadataValue.path(str(store.dataset(DATASET))),
            "dagster/row_count": len(df),
            "dagster/column_schema": presentation.columns(df),
        },
    )
