"""Inspections of run directories and their findings; ``assets.run_checks`` makes checks of them."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.remote import fetched
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.datasets import MISSING, feature_columns, read_table
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import interval_count, read_intervals


@dataclass(frozen=True, slots=True)
class Inspection:
    """One inspection of one run, or of the two runs of a pair."""

    name: str  # of a function in this module
    runs: tuple[RunDirectory, ...]

    def __str__(self) -> str:
        """Return the name of the inspection and its runs."""
        return f"{self.name} of {' and '.join(run.key for run in self.runs)}"


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of an inspection."""

    wrong: list[str]  # empty: passed
    figures: dict[str, int | float]


def inspect(inspection: Inspection) -> Finding:
    """Make an inspection; a file that cannot be read is a fault."""
    try:
        return _INSPECTIONS[inspection.name](*inspection.runs)
    except (OracleError, OSError) as error:
        return Finding([str(error)], {})


def bag_is_complete(run: RunDirectory) -> Finding:
    """Read every message of the bag, whole or trimmed, and count them against the manifest."""
    manifest = run.manifest()
    if manifest.measured.kept == "recipe":
        return Finding([], {"messages": 0, "recorded": 0})
    recorded = {name: topic.messages for name, topic in manifest.topics.items()}
    recorded.pop(GROUND_TRUTH_TOPIC, None)
    with fetched(run.bag) as folder, BagReader(folder) as bag:
        if manifest.measured.kept == "trimmed":
            recorded = {name: count for name, count in recorded.items() if name in bag.topics}
        read = dict.fromkeys(recorded, 0)
        for message in bag.messages():
            read[message.topic] = read.get(message.topic, 0) + 1
    wrong = [
        f"{topic}: {read[topic]} messages read, {recorded.get(topic, 0)} recorded"
        for topic in sorted(read)
        if read[topic] != recorded.get(topic)
    ]
    return Finding(wrong, {"messages": sum(read.values()), "recorded": sum(recorded.values())})


def every_interval_has_a_graph(run: RunDirectory) -> Finding:
    """Compare the graphs on disk with the intervals of the recording."""
    intervals = interval_count(run.manifest().recording_s)
    expected = {f"{number * INTERVAL_S:06d}" for number in range(intervals)}
    recorded = {path.stem for path in run.graphs.glob("*.gexf") if path.stem.isdecimal()}
    wrong = [f"{start} s: no graph" for start in sorted(expected - recorded)]
    wrong += [f"{start} s: no such interval" for start in sorted(recorded - expected)]
    return Finding(wrong, {"graphs": len(recorded), "intervals": intervals})


def graphs_of_a_pair_are_equal(control: RunDirectory, attacked: RunDirectory) -> Finding:
    """Compare vertices, types and edges, not counts, in every interval that both runs have."""
    ours, theirs = read_intervals(control.graphs), read_intervals(attacked.graphs)
    differences = graph_differences(ours, theirs)
    return Finding(list(map(str, differences)), {"intervals": min(len(ours), len(theirs))})


def run_features_are_finite(run: RunDirectory) -> Finding:
    """Find features of the run that are neither finite nor explained."""
    return _finite(run.feature_table("run"))


def window_features_are_finite(run: RunDirectory) -> Finding:
    """Find features of its windows that are neither finite nor explained."""
    return _finite(run.feature_table("window"))


def _finite(place: Path) -> Finding:
    df = read_table(place)
    columns = feature_columns(df)
    finite = np.isfinite(df[columns].to_numpy())
    reasons = [json.loads(row) for row in df[MISSING]]
    wrong = [
        f"row {row}, {columns[column]}: neither a number nor a reason"
        for row, column in zip(*np.nonzero(~finite), strict=True)
        if columns[column] not in reasons[row]
    ]
    figures: dict[str, int | float] = {
        "values": int(finite.size),
        "finite": int(finite.sum()),
        "reasons": sum(map(len, reasons)),
    }
    return Finding(wrong, figures)


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
