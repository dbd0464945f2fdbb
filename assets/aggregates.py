"""What the assets over all runs share: their declaration, their inputs and their results."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.asset_defaults import OWNERS, SINGLE_RUN
from assets.worker.versions import analysis_code
from oracle_pipeline.bags.remote import published
from resources.store import RunStore
from sim.modes import modes

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.reporting.report import Report

DATASET, WINDOWS, TRUTH = "features", "windows", "truth"  # tables over all runs

TestbedChoice = Literal["auto", "turtlebot3", "atc"]


class TestbedConfig(dg.Config):
    """Which testbed to analyse: runs of two testbeds have no features in common."""

    testbed: TestbedChoice = Field(
        default="auto",
        description="Testbed whose runs are analysed; by default the TurtleBot3's, or air "
        "traffic if no others are recorded.",
    )


def aggregate(
    group: str,
    *kinds: str,
    deps: Sequence[dg.AssetDep | dg.AssetsDefinition],
    freshness_policy: dg.FreshnessPolicy | None = None,
) -> Callable[[Callable[..., Any]], dg.AssetsDefinition]:
    """Decorate an asset over all runs."""
    return dg.asset(
        deps=deps,
        group_name=group,
        kinds=set(kinds),
        owners=OWNERS,
        code_version=analysis_code(),
        backfill_policy=SINGLE_RUN,
        freshness_policy=freshness_policy,
    )


def run_table(store: RunStore, testbed: TestbedChoice) -> "pd.DataFrame":
    """Return the run features of one testbed, without families that have no value there."""
    from oracle_pipeline.datasets import read_table, without_empty_families

    place = store.dataset(DATASET)
    recorded = read_table(place, columns=["mode"])["mode"].unique()
    of = {mode: modes()[mode].testbed for mode in recorded}
    if testbed == "auto":
        testbed = "turtlebot3" if "turtlebot3" in of.values() else "atc"
    chosen = [mode for mode in recorded if of[mode] == testbed]
    return without_empty_families(read_table(place, rows=("mode", chosen)))


def windows_of(store: RunStore, df: "pd.DataFrame") -> "pd.DataFrame":
    """Return the window features of the runs in a table, one row for each window."""
    from oracle_pipeline.datasets import read_table

    return read_table(store.dataset(WINDOWS), rows=("run_id", df["run_id"]))


def keep(result: "Report", store: RunStore, name: str) -> dg.MaterializeResult[None]:
    """Save a report where `oracle_report` finds it, and show it."""
    from oracle_pipeline.datasets import content_hash
    from oracle_pipeline.reporting.report import SUMMARY

    place = store.results(name)
    with published(place, last=SUMMARY) as folder:
        result.save(folder)
    return dg.MaterializeResult(
        data_version=dg.DataVersion(content_hash(result.table)),
        metadata={**presentation.report(result), "path": dg.MetadataValue.path(str(place))},
    )
