"""Compares the graphs of two runs: vertices, types and edges, but not traffic."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.graphs.intervals import Interval


@dataclass(frozen=True, slots=True, order=True)
class GraphDifference:
    """One vertex or edge that one of two runs lacks in an interval."""

    start_s: float  # of the interval
    element: str  # "topic:/scan (sensor_msgs/msg/LaserScan)" or "node:/amcl -> topic:/tf"
    only_in: Literal["a", "b"]

    def __str__(self) -> str:
        return f"at {self.start_s:.0f} s only {self.only_in} has {self.element}"


def graph_differences(a: Sequence[Interval], b: Sequence[Interval]) -> list[GraphDifference]:
    """Compare two runs over every interval that both have; the list is empty if they are equal.

    A vertex whose type differs counts as two vertices.
    """
    differences: list[GraphDifference] = []
    for ours, theirs in zip(a, b, strict=False):
        in_a, in_b = _elements(ours.graph), _elements(theirs.graph)
        differences += [GraphDifference(ours.start_s, each, "a") for each in in_a - in_b]
        differences += [GraphDifference(ours.start_s, each, "b") for each in in_b - in_a]
    return sorted(differences)


def _elements(graph: RosGraph) -> set[str]:
    vertices = {
        f"{v} ({data['type']})" if data["type"] else v for v, data in graph.nodes(data=True)
    }
    return vertices | {f"{source} -> {target}" for source, target in graph.edges}
