"""How messages flow between ROS nodes and topics, after MalChain: local, global and over time.

The flow of an edge is the number of messages (or bytes) that went over it. MalChain's graphs are of
system calls, ours of the ROS graph's intervals, without observers. An edge is shorter the more
traffic it has; without traffic its length is infinite.
"""

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.shared import once_for_graph, system_of

Edge: TypeAlias = tuple[str, str]
_Flows: TypeAlias = Mapping[Edge, int]  # messages or bytes by edge

FEATURES = fp.timed(
    fp.Feature("flow_entropy", "nat", 0.01, "Shannon entropy of the edges' shares of all messages"),
    fp.Feature("byte_flow_entropy", "nat", 0.01, "Shannon entropy of the edges' shares of bytes"),
    fp.Feature("flow_variance", "1", 0.01, "variance of the edges' message counts / squared mean",
        share=0.01),
    fp.Feature("largest_flow", "1", 1e-3, "largest share of all messages on a single edge"),
    fp.Feature("largest_byte_flow", "1", 1e-3, "largest share of all bytes on a single edge"),
    fp.Feature("closeness_mean", "1", 1e-3,
        "closeness centrality by incoming paths, mean over the vertices; the length of an edge is "
        "the mean message count over its own"),
    fp.Feature("closeness_max", "1", 1e-3,
        "closeness centrality by incoming paths, maximum over the vertices; the length of an edge "
        "is the mean message count over its own"),
    fp.Feature("imbalance", "1", 1e-3,
        "sum over the ROS nodes of abs(received - published messages), over the messages of all "
        "edges"),
    fp.Feature("imbalance_max", "1", 1e-3,
        "largest abs(received - published messages) of a ROS node, over the messages of all edges"),
    fp.Feature("flow_change", "1", 1e-3,
        "total variation distance of the edges' message shares from those of the previous "
        "interval, mean over the intervals"),
    fp.Feature("appeared_edges", "1", 1.0, "edges that the previous interval did not have"),
    fp.Feature("vanished_edges", "1", 1.0, "edges that only the previous interval had"),
    extensive=True,  # the longer a run is, the less of its traffic is that of its start
)  # fmt: skip


class _Change(NamedTuple):
    """Difference of an interval from the one before."""

    start_s: float
    shares: dict[Edge, float]  # by how much each edge's share of the messages changed
    appeared: int
    vanished: int


def prepare(window: fp.Window) -> list[_Change]:
    """Compare each interval of the recording with the one before."""
    starts = [interval.start_s for interval in window.intervals]
    systems = [system_of(interval.graph, window.shared) for interval in window.intervals]
    flows = [_flows(system, "messages") for system in systems]
    return [
        _change(start_s, before, after)
        for start_s, before, after in zip(starts[1:], flows, flows[1:], strict=False)
    ]


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute the flows of a window's graph, and the changes of the intervals that it touches."""
    assert window.system is not None  # noqa: S101 -- the plugin needs a graph
    return once_for_graph(_traffic, window, window.system)


def _traffic(window: fp.Window, graph: RosGraph) -> fp.Values | fp.Missing:
    messages, data = _flows(graph, "messages"), _flows(graph, "bytes")
    if not any(messages.values()):
        return fp.Missing("no edge has a message")
    starts = {interval.start_s for interval in window.intervals}
    changes = [each for each in window.prepared if each.start_s in starts]
    return {
        "flow_entropy": _entropy(messages),
        "byte_flow_entropy": _entropy(data),
        "flow_variance": _relative_variance(messages),
        "largest_flow": _largest_share(messages),
        "largest_byte_flow": _largest_share(data),
        **_central(messages),
        **_imbalance(graph, messages),
        **_over_time(changes),
    }


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of traffic."""
    return [
        fp.FeaturePlugin("traffic", "traffic", FEATURES, compute, needs_graph=True, prepare=prepare)
    ]


@jit
def closeness(lengths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the closeness of each vertex of a directed graph, shape (n,).

    It is over incoming paths, after Wasserman and Faust: the share of other vertices that reach a
    vertex, over their mean distance. Betweenness is omitted: it depends on the subscriptions, not
    on the traffic.

    Parameters
    ----------
    lengths : array, shape (n, n)
        Of the edge from row to column; ``inf`` without one.
    """
    n = len(lengths)
    reached, distances = np.zeros(n), np.zeros(n)
    for source in range(n):
        distance = np.full(n, np.inf)
        distance[source] = 0.0
        settled = np.zeros(n, np.bool_)
        for _ in range(n):  # Dijkstra
            here = -1
            for v in range(n):
                if not settled[v] and (here < 0 or distance[v] < distance[here]):
                    here = v
            if np.isinf(distance[here]):
                break
            settled[here] = True
            if here != source:
                reached[here] += 1.0
                distances[here] += distance[here]
            for v in range(n):
                distance[v] = min(distance[v], distance[here] + lengths[here, v])
    close = np.zeros(n)
    for v in range(n):
        if reached[v] > 0.0:
            close[v] = reached[v] / distances[v] * reached[v] / (n - 1)
    return close


def _flows(graph: RosGraph, unit: str) -> dict[Edge, int]:
    return {(source, target): edge[unit] for source, target, edge in graph.edges(data=True)}


def _shares(flows: _Flows) -> dict[Edge, float]:
    total = sum(flows.values())
    return {edge: flow / total if total else 0.0 for edge, flow in flows.items()}


def _entropy(flows: _Flows) -> float:
    shares = np.array([share for share in _shares(flows).values() if share])
    return float(-np.sum(shares * np.log(shares)))


def _relative_variance(flows: _Flows) -> float:
    numbers = np.array(list(flows.values()), dtype=np.float64)
    return float(numbers.var() / numbers.mean() ** 2)


def _largest_share(flows: _Flows) -> fp.Located:
    edge = max(flows, key=lambda each: (flows[each], each))
    return fp.Located(_shares(flows)[edge], _text(edge))


def _central(flows: _Flows) -> dict[str, float | fp.Located]:
    busy = {edge: flow for edge, flow in flows.items() if flow}
    vertices = sorted({vertex for edge in busy for vertex in edge})
    number = {vertex: i for i, vertex in enumerate(vertices)}
    mean = sum(busy.values()) / len(busy)
    lengths = np.full((len(vertices), len(vertices)), np.inf)
    for (source, target), flow in busy.items():
        lengths[number[source], number[target]] = mean / flow
    close = closeness(lengths)
    return {
        "closeness_mean": float(close.mean()),
        "closeness_max": fp.Located(float(close.max()), vertices[int(close.argmax())]),
    }


def _imbalance(graph: RosGraph, flows: _Flows) -> dict[str, float | fp.Located]:
    surplus = {vertex: 0 for vertex in sorted(graph) if graph.nodes[vertex]["kind"] == "node"}
    total = sum(flows.values())
    for (source, target), flow in flows.items():
        if source in surplus:
            surplus[source] += flow
        if target in surplus:
            surplus[target] -= flow
    where = max(surplus, key=lambda vertex: abs(surplus[vertex]))
    return {
        "imbalance": sum(map(abs, surplus.values())) / total,
        "imbalance_max": fp.Located(abs(surplus[where]) / total, where),
    }


def _over_time(changes: list[_Change]) -> dict[str, float | fp.Located | fp.Missing]:
    if not changes:
        first = fp.Missing("there is no previous interval")
        return dict.fromkeys(("flow_change", "appeared_edges", "vanished_edges"), first)
    size: dict[Edge, float] = {}
    for change in changes:
        for edge, share in change.shares.items():
            size[edge] = size.get(edge, 0.0) + abs(share)
    where = max(size, key=lambda each: (size[each], each), default=("", ""))
    return {
        "flow_change": fp.Located(sum(size.values()) / 2.0 / len(changes), _text(where)),
        "appeared_edges": float(sum(change.appeared for change in changes)),
        "vanished_edges": float(sum(change.vanished for change in changes)),
    }


def _change(start_s: float, before: _Flows, after: _Flows) -> _Change:
    old, new = _shares(before), _shares(after)
    edges = sorted(old.keys() | new.keys())
    shares = {edge: new.get(edge, 0.0) - old.get(edge, 0.0) for edge in edges}
    return _Change(start_s, shares, len(new.keys() - old.keys()), len(old.keys() - new.keys()))


def _text(edge: Edge) -> str:
    return " -> ".join(edge)
