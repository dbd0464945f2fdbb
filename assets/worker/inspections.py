"""Inspections of run directories and their findings; ``assets.run_checks`` makes them checks."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from assets.worker.kept_tables import read_tables
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.integrity import damaged_files, require_undamaged
from oracle_pipeline.bags.layout import TableName
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.reader import counts_and_hash
from oracle_pipeline.bags.remote import fetched
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER, RunDirectory
from oracle_pipeline.datasets import MISSING, feature_columns
from oracle_pipeline.features.engine.kept_messages import KeptMessages
from oracle_pipeline.features.extraction import only_robot
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import interval_count, read_intervals
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring.contract import Observation, Observer
from oracle_pipeline.scoring.isolation import interfaces

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Inspection:
    """One inspection of one run, of the two runs of a pair, or of the tables of several."""

    name: str  # of a function in this module
    runs: tuple[RunDirectory, ...]

    def __str__(self) -> str:
        """Return the name of the inspection and its runs."""
        return f"{self.name} of {' and '.join(run.key for run in self.runs)}"


@dataclass(frozen=True, slots=True)
class InspectionResult:
    """What an inspection has found."""

    wrong: list[str]  # empty: passed
    figures: dict[str, int | float]


def inspect(inspection: Inspection) -> InspectionResult:
    """Perform an inspection; an unreadable file is a fault."""
    try:
        return _INSPECTIONS[inspection.name](*inspection.runs)
    except (OracleError, OSError) as error:
        return InspectionResult([str(error)], {})


def bag_is_complete(run: RunDirectory) -> InspectionResult:
    """Read every message of the bag, whole or trimmed, and compare it with the manifest.

    A complete bag must have the content hash in the manifest. For a trimmed bag, the manifest has
    the hashes of its files.
    """
    manifest = run.manifest()
    kept = manifest.measured.kept
    if kept == "recipe":
        return InspectionResult([], {"messages": 0, "recorded": 0})
    recorded = {name: topic.messages for name, topic in manifest.topics.items()}
    with fetched(run.path) as folder:
        damaged = damaged_files(folder, manifest, BAG_FOLDER)
        held, hash_read = counts_and_hash(folder / BAG_FOLDER)  # needs every message
    if kept == "trimmed":
        recorded = {name: count for name, count in recorded.items() if name in held}
    wrong = [
        f"{topic}: {held.get(topic, 0)} messages read, {recorded.get(topic, 0)} recorded"
        for topic in sorted(held | recorded)
        if held.get(topic) != recorded.get(topic)
    ]
    wrong += [f"{file} has changed since it was recorded" for file in damaged]
    if kept == "full" and hash_read != manifest.content_hash:
        wrong.append(f"the messages' hash is {hash_read}, recorded was {manifest.content_hash}")
    figures: dict[str, int | float] = {
        "messages": sum(held.values()),
        "recorded": sum(recorded.values()),
        "hashed_files": sum(file.startswith(BAG_FOLDER) for file in manifest.measured.files),
    }
    return InspectionResult(wrong, figures)


def every_interval_has_a_graph(run: RunDirectory) -> InspectionResult:
    """Compare the graphs on disk with the intervals of the recording."""
    intervals = interval_count(run.manifest().recording_s)
    expected = {f"{number * INTERVAL_S:06d}" for number in range(intervals)}
    recorded = {path.stem for path in run.graphs.glob("*.gexf") if path.stem.isdecimal()}
    wrong = [f"{start} s: no graph" for start in sorted(expected - recorded)]
    wrong += [f"{start} s: no such interval" for start in sorted(recorded - expected)]
    damaged = damaged_files(run.path, run.manifest(), GRAPHS_FOLDER)
    wrong += [f"{file} has changed since it was recorded" for file in damaged]
    return InspectionResult(wrong, {"graphs": len(recorded), "intervals": intervals})


def graphs_of_a_pair_are_equal(control: RunDirectory, attacked: RunDirectory) -> InspectionResult:
    """Compare vertices, types and edges, not counts, in every interval that both runs have."""
    for run in (control, attacked):
        require_undamaged(run.path, run.manifest(), GRAPHS_FOLDER)
    ours, theirs = read_intervals(control.graphs), read_intervals(attacked.graphs)
    differences = graph_differences(ours, theirs)
    return InspectionResult(list(map(str, differences)), {"intervals": min(len(ours), len(theirs))})


def run_features_are_finite(*runs: RunDirectory) -> InspectionResult:
    """Find features of runs that are neither finite nor have a reason."""
    return _finite(runs, "run")


def window_features_are_finite(*runs: RunDirectory) -> InspectionResult:
    """Find features of windows of runs that are neither finite nor have a reason."""
    return _finite(runs, "window")


def _finite(runs: Sequence[RunDirectory], table: TableName) -> InspectionResult:
    parts = [_finite_in(df) for df in read_tables(runs, table)]
    names = parts[0].figures
    return InspectionResult(
        [wrong for part in parts for wrong in part.wrong],
        {name: sum(part.figures[name] for part in parts) for name in names},
    )


def _finite_in(df: "pd.DataFrame") -> InspectionResult:
    columns = feature_columns(df)
    finite = np.isfinite(df[columns].to_numpy())
    reasons = [json.loads(row) for row in df[MISSING]]
    wrong = [
        f"{df['run_id'].iloc[row]}, row {row}, {columns[column]}: neither a number nor a reason"
        for row, column in zip(*np.nonzero(~finite), strict=True)
        if columns[column] not in reasons[row]
    ]
    figures: dict[str, int | float] = {
        "values": int(finite.size),
        "finite": int(finite.sum()),
        "reasons": sum(map(len, reasons)),
    }
    return InspectionResult(wrong, figures)


def observe(run: RunDirectory) -> Observation:
    """Return the interfaces of a run with a whole bag, as a contract compares them."""
    with fetched(run.path) as folder, open_run(folder) as opened:
        robot = only_robot(opened)
        observer = Observer(robot)
        recording = KeptMessages.read(robot, (), see=observer.see)
        return interfaces(observer, opened, robot, recording.clock, recording.times_ns)


_INSPECTIONS = {
    function.__name__: function
    for function in (
        bag_is_complete,
        every_interval_has_a_graph,
        graphs_of_a_pair_are_equal,
        run_features_are_finite,
        window_features_are_finite,
    )
}
