"""Results that the windows of a recording share, since most of them have the same graph."""

from collections.abc import Callable
from typing import Any, TypeVar

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.features.engine.plugin import Window
from oracle_pipeline.graphs.views import system_view

R = TypeVar("R")


def once_for_graph(compute: Callable[[Window, RosGraph], R], window: Window, graph: RosGraph) -> R:
    """Return what a function computes for the first window with a graph, for the others too.

    It may use what depends on nothing but the intervals that the graph was composed of.
    """
    key = compute, graph
    if key not in window.shared:
        window.shared[key] = compute(window, graph)
    result: R = window.shared[key]
    return result


def system_of(graph: RosGraph, shared: dict[Any, Any]) -> RosGraph:
    """Return the system view of a graph, frozen; ``shared`` is that of the windows."""
    key = system_view, graph
    if key not in shared:
        import networkx as nx

        shared[key] = nx.freeze(system_view(graph))
    view: RosGraph = shared[key]
    return view
