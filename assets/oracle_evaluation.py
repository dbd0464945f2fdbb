"""Our own evaluation of the oracle, over distinct runs and held-out blocks."""

from functools import partial
from typing import TYPE_CHECKING

import dagster as dg

from assets.aggregates import TRUTH, TestbedConfig, aggregate, keep, run_table, windows_of
from assets.feature_dataset import feature_dataset
from assets.run_checks import PAIR_CHECK, complete_pairs
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.fleet import Fleet
from resources.store import RunStore

if TYPE_CHECKING:
    from oracle_pipeline.scoring.contract import Observation
    from oracle_pipeline.scoring.measured_runs import MeasuredRuns


@aggregate("oracle", "scikitlearn", deps=[feature_dataset])
def oracle_evaluation(
    context: dg.AssetExecutionContext, config: TestbedConfig, store: RunStore, fleet: Fleet
) -> dg.MaterializeResult[None]:
    """How well the oracle separates attacked from normal runs, on held-out blocks.

    Every run gets the verdict of `oracle score`, by a card of other blocks: how often the exit code
    is 1 for attacked and for normal runs, with intervals; false alarms an hour, time to detect.
    With a red integrity check, nothing is claimed. Grids below `<root>/grids`, recorded with
    `oracle-sim grid`, add the kill matrix.
    """
    from oracle_pipeline.datasets import read_table
    from oracle_pipeline.evaluation.campaign_evaluation import evaluate
    from oracle_pipeline.reporting.evaluation_report import evaluation_report

    df = run_table(store, config.testbed)
    evaluation = evaluate(
        df,
        windows_of(store, df),
        read_table(store.dataset(TRUTH)),
        observations=_observations(context, store, fleet, list(df["run_id"])),
        graph_differences=_graph_differences(store, fleet, set(df["run_id"])),
        grid=_mutants(store, fleet),
        progress=lambda step: context.log.info(f"Evaluating: {step}."),
        each=partial(fleet.results, done="folds judged"),
    )
    report = evaluation_report(evaluation)
    context.log.info(f"{report.summary['headline']} {report.summary['verdicts']}".strip())
    return keep(report, store, "oracle_evaluation")


def _observations(
    context: dg.AssetExecutionContext, store: RunStore, fleet: Fleet, runs: list[str]
) -> "dict[str, Observation]":
    """Return the interfaces of the runs; empty if the bag of one is not whole any more."""
    from assets.worker.inspections import observe

    whole = [run for run in map(store.run, runs) if run.manifest().measured.kept == "full"]
    if len(whole) < len(runs):
        context.log.warning(
            f"Verdicts are by features alone: {len(runs) - len(whole)} bags were trimmed or "
            "dropped, so the contract cannot be compared. Raise ORACLE_STORAGE_BUDGET."
        )
        return {}
    return {
        outcome.job.key: outcome.result
        for outcome in fleet.outcomes(observe, whole, "runs read for the contract")
        if outcome.result is not None
    }


def _graph_differences(store: RunStore, fleet: Fleet, runs: set[str]) -> list[str] | None:
    """Return the differences between graphs of complete pairs; None without a complete pair."""
    from assets.worker.inspections import Inspection, inspect

    inspections = [Inspection(PAIR_CHECK, pair) for pair in complete_pairs(map(store.run, runs))]
    if not inspections:
        return None
    return [
        f"{outcome.job.runs[1].key}: {wrong}"
        for outcome in fleet.outcomes(inspect, inspections, "pairs of graphs compared")
        for wrong in (outcome.result.wrong if outcome.result else [str(outcome.error)])
    ]


def _mutants(store: RunStore, fleet: Fleet) -> "MeasuredRuns | None":
    """Return features and windows of the runs of all grids, with the changes of each run."""
    import pandas as pd

    from assets.worker.feature_tables import require_tables
    from assets.worker.kept_tables import read_tables
    from oracle_pipeline.datasets import feature_dataset as joined
    from oracle_pipeline.datasets import window_dataset
    from oracle_pipeline.scoring.measured_runs import MeasuredRuns

    runs_of_grids, windows_of_grids = [], []
    for index in store.grid_indices():
        with index.open("rb") as source:
            mutants = pd.read_json(source)
        runs = [RunDirectory.of_key(index.parent, key) for key in mutants["run_id"]]
        fleet.results(require_tables, runs, "runs of grids read")
        df = joined(read_tables(runs, "run"))
        changes = mutants[["run_id", "scenario", "parameter", "value", "changed_messages"]]
        df = df.merge(changes, on="run_id", validate="one_to_one")
        windows = window_dataset(read_tables(runs, "window"))
        grid = f"{index.parent.name}/"  # two grids may have runs of the same name
        runs_of_grids.append(df.assign(run_id=grid + df["run_id"]))
        windows_of_grids.append(windows.assign(run_id=grid + windows["run_id"]))
    if not runs_of_grids:
        return None
    return MeasuredRuns.ordered(
        pd.concat(runs_of_grids, ignore_index=True), pd.concat(windows_of_grids, ignore_index=True)
    )
