"""Checks of every run, performed whenever the run is materialized.

One step performs all selected checks on the fleet, with a separate result for each partition. A
failed check is an error to investigate, but does not block any asset.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import dagster as dg

from assets.events import check_evaluation, latest_materializations
from assets.partitions import RUNS
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.fleet import Fleet
from resources.store import RunStore

if TYPE_CHECKING:
    from assets.worker.inspections import Inspection, InspectionResult

SHOWN = 10  # faults named in the description of a result

PAIR_CHECK = "graphs_of_a_pair_are_equal"
OF_TABLES = ("window_features_are_finite", "run_features_are_finite")  # joined for a partition
CHECKS = tuple(
    dg.AssetCheckSpec(name, asset=asset, partitions_def=RUNS, description=description)
    for name, asset, description in (
        ("bag_is_complete", "bags",
            "Every message that the manifest counts can be read from the bag, and the hashes of "
            "messages and files are those of the manifest."),
        ("every_interval_has_a_graph", "interval_graphs",
            "Every interval of 10 s of the recording, and a last one of at least 5 s, has a graph, "
            "and no graph file has changed."),
        (PAIR_CHECK, "interval_graphs",
            "An attacked run and its control have equal vertices, types and edges in every "
            "interval that both have. There is no result until both are recorded."),
        ("window_features_are_finite", "window_features",
            "Every feature of every window is a finite number, or empty with a reason."),
        ("run_features_are_finite", "run_features",
            "Every feature of the run is a finite number, or empty with a reason."),
    )
)  # fmt: skip


@dg.multi_asset_check(name="checks_of_runs", specs=CHECKS, can_subset=True)
def checks_of_runs(
    context: dg.AssetCheckExecutionContext, store: RunStore, fleet: Fleet
) -> Iterator[dg.AssetCheckEvaluation | dg.Output[None]]:
    """Inspect the runs of the partitions."""
    from assets.worker.inspections import Inspection, InspectionResult, inspect

    specs = {spec.name: spec for spec in CHECKS if spec.key in context.selected_asset_check_keys}
    partitions = {key: store.runs(key) for key in context.op_execution_context.partition_keys}
    inspections = [
        Inspection(name, subject) for name in specs for subject in _subjects(name, partitions)
    ]
    found: dict[str, dict[str, list[tuple[Inspection, InspectionResult]]]] = {
        name: {key: [] for key in partitions} for name in specs
    }
    of_run = {run: key for key, runs in partitions.items() for run in runs}
    for outcome in fleet.outcomes(inspect, inspections, "inspections done"):
        result = outcome.result or InspectionResult(
            [outcome.error or "the inspection ended early"], {}
        )
        for key in {of_run[run] for run in outcome.job.runs if run in of_run}:
            found[outcome.job.name][key].append((outcome.job, result))
    for name, spec in specs.items():
        targets = latest_materializations(context.instance, spec.asset_key, list(partitions))
        results = {key: _together(of) for key, of in found[name].items() if of}
        for key, (wrong, figures) in results.items():
            yield check_evaluation(
                spec,
                key,
                targets.get(key),
                passed=not wrong,
                description="; ".join(wrong[:SHOWN]) or None,
                metadata={**figures, "wrong": len(wrong)},
            )
        failed = [key for key, (wrong, _) in results.items() if wrong]
        outcome_of_all = f"failed for {', '.join(failed[:SHOWN])}" if failed else "passed"
        context.log.info(f"Check {name} of {len(of_run)} runs: {outcome_of_all}.")
    for spec in specs.values():
        yield dg.Output(None, output_name=spec.get_python_identifier())


def _subjects(
    name: str, partitions: Mapping[str, Sequence[RunDirectory]]
) -> Iterable[tuple[RunDirectory, ...]]:
    """Return the runs that each inspection of a kind compares."""
    if name in OF_TABLES:
        return [tuple(runs) for runs in partitions.values()]
    runs = [run for of in partitions.values() for run in of]
    return complete_pairs(runs) if name == PAIR_CHECK else [(run,) for run in runs]


def _together(
    results: "Sequence[tuple[Inspection, InspectionResult]]",
) -> tuple[list[str], dict[str, int | float]]:
    """Return what is wrong in the runs of a partition, and the sums of their figures."""
    several = len(results) > 1
    wrong = [
        f"{job.runs[-1].run_id}: {each}" if several else each
        for job, result in results
        for each in result.wrong
    ]
    names = dict.fromkeys(name for _, result in results for name in result.figures)
    return wrong, {name: sum(of.figures.get(name, 0) for _, of in results) for name in names}


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
