"""Helpers for assets over all runs: declaration, inputs and results."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.asset_defaults import SINGLE_RUN, declared
from assets.partitions import testbed_of
from assets.worker.versions import analysis_code
from oracle_pipeline.bags.remote import published
from resources.failures import clear_failures
from resources.store import RunStore
from sim.modes import modes
from sim.testbeds import TESTBEDS, require_testbed

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.reporting.stored_report import Report

AUTO = "auto"
DATASET, WINDOWS, TRUTH = "features", "windows", "truth"  # tables over all runs


class TestbedConfig(dg.Config):
    """Which testbed to analyse: runs of two testbeds have no features in common."""

    testbed: str = Field(
        default=AUTO,
        description=f"Testbed whose runs are analysed: {', '.join(TESTBEDS)}; {AUTO}: the first of "
        "these with recorded runs.",
    )


def aggregate(
    group: str,
    *kinds: str,
    deps: Sequence[dg.AssetDep | dg.AssetsDefinition],
    place: str = "",
    freshness_policy: dg.FreshnessPolicy | None = None,
) -> Callable[[Callable[..., Any]], dg.AssetsDefinition]:
    """Decorate an asset over all runs.

    Parameters
    ----------
    group, kinds, deps, freshness_policy
        As for Dagster's ``asset``.
    place
        Path of its content below the root of the store; by default, where `keep` saves it.
    """

    def decorate(function: Callable[..., Any]) -> dg.AssetsDefinition:
        return dg.asset(
            deps=deps,
            group_name=group,
            kinds=set(kinds),
            code_version=analysis_code(function.__module__),
            backfill_policy=SINGLE_RUN,
            freshness_policy=freshness_policy,
            **declared("campaign", place or f"report/parts/{function.__name__}"),
        )(clear_failures()(function))

    return decorate


def run_table(store: RunStore, testbed: str) -> "pd.DataFrame":
    """Return the run features of one testbed, without families that have no value.

    Raises
    ------
    TestbedError
        If the testbed does not exist.
    """
    from oracle_pipeline.datasets import read_table, without_empty_families

    df = read_table(store.dataset(DATASET))
    of = {mode: testbed_of(mode) for mode in df["mode"].unique() if mode in modes()}
    if testbed == AUTO:
        testbed = next((name for name in TESTBEDS if name in of.values()), next(iter(TESTBEDS)))
    require_testbed(testbed)
    return without_empty_families(df[df["mode"].map(of) == testbed].reset_index(drop=True))


def windows_of(store: RunStore, df: "pd.DataFrame") -> "pd.DataFrame":
    """Return the window features of the runs in a table, one row for each window, without texts."""
    from oracle_pipeline.datasets import MISSING, WHERE, read_table

    return read_table(store.dataset(WINDOWS), without=[WHERE, MISSING], runs=df["run_id"])


def keep(result: "Report", store: RunStore, name: str) -> dg.MaterializeResult[None]:
    """Save a report for `oracle_report`, show it in the UI, and log its path."""
    from oracle_pipeline.datasets import content_hash
    from oracle_pipeline.reporting.stored_report import SUMMARY

    place = store.results(name)
    with published(place, last=SUMMARY) as folder:
        result.save(folder)
    dg.get_dagster_logger().info(
        f"Saved {name} in {place}: a table of {len(result.table)} rows, {len(result.tables)} more "
        "tables. `oracle_report` includes them."
    )
    return dg.MaterializeResult(
        data_version=dg.DataVersion(content_hash(result.table)),
        metadata={**presentation.report(result), "path": dg.MetadataValue.path(str(place))},
    )
