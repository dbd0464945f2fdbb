"""Features of the ROS graph's shape: the thesis's seven, computed as named, and related ones.

The thesis's code differs from its text; docs/reference/features.md shows its numbers beside ours.
``structural.*`` describes the system view, without observers. ``structural_raw.*`` describes all
nodes, so it also shows how a run was observed; its features are therefore marked as shortcuts.
"""

import functools
from dataclasses import replace
from operator import or_

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.shared import once_for_graph

FEATURES = (
    fp.Feature("max_degree", "1", 1.0, "largest degree (number of edges) of a vertex"),
    fp.Feature("max_in_degree", "1", 1.0, "largest in-degree of a vertex"),
    fp.Feature("max_out_degree", "1", 1.0, "largest out-degree of a vertex"),
    fp.Feature("average_degree", "1", 0.01, "mean degree of n vertices with m edges, 2m/n"),
    fp.Feature("density", "1", 1e-4, "edges over all ordered pairs of vertices, m/(n(n-1))"),
    fp.Feature("bipartite_density", "1", 1e-3,
        "edges over all possible node-topic edges, m/(2 x nodes x topics)"),
    fp.Feature("degree_entropy", "nat", 0.01, "Shannon entropy of the degree distribution"),
    fp.Feature("node_entropy", "1", 1e-3,
        "Shannon entropy of the vertices' shares of the total degree, over its maximum ln n"),
    fp.Feature("degree_variance", "1", 0.1, "variance of the degrees"),
    fp.Feature("degree_cv", "1", 0.01, "coefficient of variation of the degrees"),
    fp.Feature("max_in_degree_centrality", "1", 1e-3, "largest in-degree divided by n-1"),
    fp.Feature("mean_betweenness", "1", 1e-5, "mean betweenness centrality"),
)  # fmt: skip


def graph_shape(graph: RosGraph) -> dict[str, float]:
    """Compute the structural features of a graph of ROS nodes and topics with at least one edge.

    With n vertices, m edges, degrees d_i and q_k the share of vertices of degree k: the degree
    entropy is -sum q_k ln q_k, the node entropy -sum p_i ln p_i / ln n with p_i = d_i / 2m.
    """
    n, m = graph.number_of_nodes(), graph.number_of_edges()
    degrees = np.array([degree for _, degree in graph.degree()], dtype=np.float64)
    in_degrees = [degree for _, degree in graph.in_degree()]
    out_degrees = [degree for _, degree in graph.out_degree()]
    n_nodes = sum(data["kind"] == "node" for _, data in graph.nodes(data=True))
    return {
        "max_degree": float(degrees.max()),
        "max_in_degree": float(max(in_degrees)),
        "max_out_degree": float(max(out_degrees)),
        "average_degree": 2.0 * m / n,
        "density": m / (n * (n - 1)),
        "bipartite_density": m / (2 * n_nodes * (n - n_nodes)),
        "degree_entropy": _entropy(np.unique(degrees, return_counts=True)[1] / n),
        "node_entropy": _entropy(degrees[degrees > 0] / degrees.sum()) / np.log(n),
        "degree_variance": float(degrees.var()),
        "degree_cv": float(degrees.std() / degrees.mean()),
        "max_in_degree_centrality": max(in_degrees) / (n - 1),
        "mean_betweenness": _mean_betweenness(graph),
    }


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute the shape of the system."""
    assert window.system is not None  # noqa: S101 -- the plugin needs a graph
    return once_for_graph(_compute, window, window.system)


def _compute_raw(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute the shape of the whole graph, including observers."""
    assert window.graph is not None  # noqa: S101 -- the plugin needs a graph
    return once_for_graph(_compute, window, window.graph)


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the structural features."""
    shortcuts = tuple(
        replace(each, shortcut=True, description=f"{each.description}; graph with observers")
        for each in FEATURES
    )
    return [
        fp.FeaturePlugin("structural", "structural", FEATURES, compute, needs_graph=True),
        fp.FeaturePlugin(
            "structural_raw", "structural_raw", shortcuts, _compute_raw, needs_graph=True
        ),
    ]


def _compute(_: fp.Window, graph: RosGraph) -> fp.Values | fp.Missing:
    if not graph.edges:
        return fp.Missing("the graph has no edges")
    vertices = frozenset((vertex, data["kind"]) for vertex, data in graph.nodes(data=True))
    return _shape(vertices, frozenset(graph.edges))


@functools.lru_cache(maxsize=64)
def _shape(
    vertices: frozenset[tuple[str, str]], edges: frozenset[tuple[str, str]]
) -> dict[str, float]:
    """Most windows of a run have the same graph: compute its shape once."""
    import networkx as nx

    graph: RosGraph = nx.DiGraph()
    graph.add_nodes_from((vertex, {"kind": kind}) for vertex, kind in sorted(vertices))
    graph.add_edges_from(sorted(edges))
    return graph_shape(graph)


def _mean_betweenness(graph: RosGraph) -> float:
    """Return the mean betweenness from distances: a path of k edges has k - 1 inner vertices."""
    n = graph.number_of_nodes()
    bit = {vertex: 1 << place for place, vertex in enumerate(graph)}
    within = dict(bit)  # what can be reached from a vertex in so many steps, a bit for each
    inside = steps = 0
    grown = n
    while grown:
        further = {
            vertex: functools.reduce(or_, map(within.__getitem__, graph.successors(vertex)), own)
            for vertex, own in bit.items()
        }
        grown = sum(reached.bit_count() - within[v].bit_count() for v, reached in further.items())
        within = further
        inside += steps * grown  # behind the first step, one vertex inside each
        steps += 1
    return inside / (n * max(1, (n - 1) * (n - 2)))


def _entropy(shares: NDArray[np.float64]) -> float:
    return float(-np.sum(shares * np.log(shares)))
