"""Checks of every run, performed whenever the run is materialized.

One step performs all selected checks on the fleet, with a separate result for each run. A failed
check is an error to investigate, but does not block any asset.
"""

from collections.abc import Iterable, Iterator

import dagster as dg

from assets.events import check_evaluation, latest_materializations
from assets.partitions import RUNS
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.fleet import Fleet
from resources.store import RunStore

SHOWN = 10  # faults named in the description of a result

PAIR_CHECK = "graphs_of_a_pair_are_equal"
CHECKS = (
    dg.AssetCheckSpec(
        "bag_is_complete",
        asset="bags",
        partitions_def=RUNS,
        description="Every message that the manifest counts can be read from the bag, and the "
        "hashes of messages and files are those of the manifest.",
    ),
    dg.AssetCheckSpec(
        "every_interval_has_a_graph",
        asset="interval_graphs",
        partitions_def=RUNS,
        description="Every interval of 10 s of the recording, and a last one of at least 5 s, has "
        "a graph, and no graph file has changed.",
    ),
    dg.AssetCheckSpec(
        PAIR_CHECK,
        asset="interval_graphs",
        partitions_def=RUNS,
        description="An attacked run and its control have equal vertices, types and edges in every "
        "interval that both have. There is no result until both are recorded.",
    ),
    dg.AssetCheckSpec(
        "window_features_are_finite",
        asset="window_features",
        partitions_def=RUNS,
        description="Every feature of every window is a finite number, or empty with a reason.",
    ),
    dg.AssetCheckSpec(
        "run_features_are_finite",
        asset="run_features",
        partitions_def=RUNS,
        description="Every feature of the run is a finite number, or empty with a reason.",
    ),
)


@dg.multi_asset_check(name="checks_of_runs", specs=CHECKS, can_subset=True)
def checks_of_runs(
    context: dg.AssetCheckExecutionContext, store: RunStore, fleet: Fleet
) -> Iterator[dg.AssetCheckEvaluation | dg.Output[None]]:
    """Inspect the runs of the partitions."""
    from assets.worker.inspections import Inspection, InspectionResult, inspect

    specs = {spec.name: spec for spec in CHECKS if spec.key in context.selected_asset_check_keys}
    runs = {key: store.run(key) for key in context.op_execution_context.partition_keys}
    inspections = [
        Inspection(name, subject)
        for name in specs
        for subject in (
            complete_pairs(runs.values())
            if name == PAIR_CHECK
            else [(run,) for run in runs.values()]
        )
    ]
    targets = {
        asset: latest_materializations(context.instance, asset, list(runs))
        for asset in {spec.asset_key for spec in specs.values()}
    }
    wrong: dict[str, list[str]] = {name: [] for name in specs}
    for outcome in fleet.outcomes(inspect, inspections, "inspections done"):
        found = outcome.result or InspectionResult(
            [outcome.error or "the inspection ended early"], {}
        )
        if found.wrong:
            wrong[outcome.job.name] += [run.key for run in outcome.job.runs if run.key in runs]
        for run in outcome.job.runs:
            if run.key in runs:
                spec = specs[outcome.job.name]
                yield check_evaluation(
                    spec,
                    run.key,
                    targets[spec.asset_key].get(run.key),
                    passed=not found.wrong,
                    description="; ".join(found.wrong[:SHOWN]) or None,
                    metadata={**found.figures, "wrong": len(found.wrong)},
                )
    for name, keys in wrong.items():
        result = f"failed for {', '.join(keys[:SHOWN])}" if keys else "passed"
        context.log.info(f"Check {name} of {len(runs)} runs: {result}.")
    for spec in specs.values():
        yield dg.Output(None, output_name=spec.get_python_identifier())


def complete_pairs(runs: Iterable[RunDirectory]) -> list[tuple[RunDirectory, RunDirectory]]:
    """Return control and attacked run of each complete pair with at least one of the runs."""
    ours = set(runs)
    pairs = [
        (RunDirectory(root, control, number), RunDirectory(root, attacked, number))
        for root, number in sorted({(run.root, run.run) for run in ours})
        for control, attacked in PAIRS
    ]
    return [
        pair
        for pair in pairs
        if not ours.isdisjoint(pair) and all(run.is_complete() for run in pair)
    ]
