"""The graphs of a run, one for each interval, and their composition."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from oracle_pipeline.bags.errors import GraphError
from oracle_pipeline.bags.graph_files import RosGraph, read_gexf
from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S

_FILE = re.compile(r"(\d{6,})\.gexf")


class Interval(NamedTuple):
    """The graph of one interval: nodes, topics, and the traffic of each edge."""

    start_s: float  # since the start of the recording [s]
    graph: RosGraph


def read_intervals(folder: Path, *, gaps: bool = False) -> tuple[Interval, ...]:
    """Read ``000000.gexf``, ``000010.gexf``, ... in order of time.

    A recording shorter than half an interval has none. In a live recording there may be gaps:
    intervals without a message.

    Raises
    ------
    GraphError
        If the folder or a graph is missing, or a graph cannot be read.
    """
    files = folder.glob("*.gexf")
    starts = {int(match[1]): path for path in files if (match := _FILE.fullmatch(path.name))}
    expected = [number * INTERVAL_S for number in range(len(starts))]
    if not folder.is_dir() or (sorted(starts) != expected and not gaps):
        raise GraphError(
            f"{folder} should have one graph every {INTERVAL_S} s from 000000.gexf on, but has "
            f"those at {sorted(starts)} s; record the run again."
        )
    return tuple(Interval(float(start), read_gexf(starts[start])) for start in sorted(starts))


def interval_count(recording_s: float) -> int:
    """Return the number of intervals of a recording, with a partial last one of 5 s or more."""
    whole, rest_s = divmod(recording_s, INTERVAL_S)
    return int(whole) + (rest_s >= MIN_INTERVAL_S)


def compose(graphs: Iterable[RosGraph]) -> RosGraph:
    """Return the union of graphs; the traffic of common edges is summed."""
    import networkx as nx

    union: RosGraph = nx.DiGraph()
    for graph in graphs:
        union.add_nodes_from(graph.nodes(data=True))
        for source, target, traffic in graph.edges(data=True):
            common = union.get_edge_data(source, target)
            if common is None:
                union.add_edge(source, target, messages=traffic["messages"], bytes=traffic["bytes"])
            else:
                common["messages"] += traffic["messages"]
                common["bytes"] += traffic["bytes"]
    return union


def known_in(
    intervals: Sequence[Interval], start_s: float, end_s: float, recorded_s: float
) -> tuple[Interval, ...]:
    """Return the intervals that overlap a span and whose graphs were complete when it ended.

    A graph is complete at the end of its interval. If no overlapping interval has ended, the result
    is the newest earlier one; in the first interval of a recording it is empty.

    Parameters
    ----------
    intervals : sequence of Interval
        Of the recording, in order of time.
    start_s, end_s : float
        Of the span, since the start of the recording [s].
    recorded_s : float
        Length of the recording, which may end its last interval early [s].
    """
    ended = tuple(each for each in intervals if min(each.start_s + INTERVAL_S, recorded_s) <= end_s)
    return tuple(each for each in ended if start_s < each.start_s + INTERVAL_S) or ended[-1:]
