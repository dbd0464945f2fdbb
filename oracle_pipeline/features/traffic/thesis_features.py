"""The ten features that the thesis's code computes for a run, used by its variant of the method.

They differ from what their names say. Corrected features are in ``structural``, ``odometry``,
``laser_ranges`` and ``goals``; docs/explanation/thesis.md lists the differences. As in the thesis's
code, there are two plugins: an error in the messages loses all three contextual features, never the
structural ones, and a NaN becomes 0. Plugins in the thesis's *form* are in ``thesis``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import arc_tangents
from oracle_pipeline.features.statistics.arrays import each
from oracle_pipeline.graphs.views import thesis_view
from oracle_pipeline.robots.roles import ODOMETRY, SCAN


def _of_run(name: str, unit: str, floor: float, description: str, **more: Any) -> fp.Feature:
    return fp.Feature(name, unit, floor, f"thesis's code: {description}", per_window=False, **more)


_STRUCTURAL = (
    _of_run("max_degree", "1", 1.0, "most frequent degree, the smallest if tied"),
    _of_run("avg_degree", "1", 0.01, "number of vertices over the largest degree plus one"),
    _of_run("density", "1", 1e-4, "edges over all ordered pairs of vertices, m/(n(n-1))"),
    _of_run("entropy", "nat", 0.01, "entropy of the degrees' shares; 0 if a degree is 0"),
    _of_run("max_centrality", "1", 1e-3, "largest in-degree divided by n-1"),
    _of_run("avg_centrality", "1", 1e-4, "mean in-degree over n-1, which equals the density"),
    _of_run("variance", "1", 0.1, "variance of the degrees, including observers"),
)
_CONTEXTUAL = (
    _of_run("yaw_variance", "rad^2", 1e-3, "variance of yaw wrapped to (-pi, pi]", origin="domain"),
    _of_run(
        "range_variance", "m^2", 1e-3, "mean over the scans of the variance of their ranges; 0 "
        "if any range is inf or NaN", origin="domain",
    ),
    _of_run("duration_ns", "ns", 1e8, "time from the first to the last message of the bag"),
)  # fmt: skip

#: Columns in the order of the thesis's vectors.
VECTOR = tuple(f"thesis.{feature.name}" for feature in (*_STRUCTURAL, *_CONTEXTUAL))


def graph_numbers(graph: RosGraph) -> dict[str, float]:
    """Compute the structural features of a graph with at least one vertex."""
    import networkx as nx

    degrees = np.array([degree for _, degree in graph.degree()])
    vertices_of_degree = np.bincount(degrees)
    centrality = list(nx.in_degree_centrality(graph).values())
    share = degrees / degrees.sum()
    entropy = -np.sum(share * np.log(share))  # NaN with a vertex without edges
    return {
        "max_degree": float(np.argmax(vertices_of_degree)),
        "avg_degree": len(degrees) / len(vertices_of_degree),
        "density": nx.density(graph),
        "entropy": _nan_to_zero(entropy),
        "max_centrality": max(centrality),
        "avg_centrality": sum(centrality) / len(centrality),
        "variance": float(np.var(degrees)),
    }


def _compute_structural(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute from the graph of the run as it was recorded: nodes and topics, observers too."""
    assert window.graph is not None  # noqa: S101 -- the plugin needs a graph
    graph = thesis_view(window.graph)
    return graph_numbers(graph) if len(graph) else fp.Missing("the graph has no vertices")


def _wrapped_yaw(messages: Any) -> NDArray[np.float64]:
    """Return yaw [rad] in (-pi, pi] of ``nav_msgs/msg/Odometry``.

    Raises
    ------
    ValueError
        Rounding took the sine of the pitch out of [-1, 1], which ends the thesis's loop too.
    """
    q = messages.pose.pose.orientation
    if (np.abs(2.0 * (q.x * q.z - q.w * q.y)) > 1.0).any():
        raise ValueError("the sine of a pitch is not in [-1, 1]")
    x, y, z, w = (np.array([each**2 for each in part.tolist()]) for part in (q.x, q.y, q.z, q.w))
    return arc_tangents(2.0 * (q.x * q.y + q.w * q.z), w + x - y - z)


def range_variance(messages: Any) -> NDArray[np.float64]:
    """Return the variance of all ranges of scans [m^2]; NaN if one of them is not finite."""
    return np.array(each(_row_variances, messages.ranges))


def _row_variances(ranges: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    if not ranges.size:
        return np.full(len(ranges), np.nan)
    return np.asarray(np.var(ranges.astype(np.float64), axis=1))


def _compute_contextual(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute from the robot's odometry and scans; the thesis names topics instead."""
    duration_ns = round((window.end_s - window.start_s) * 1e9) - 1  # the end is exclusive
    if duration_ns == 0:
        return fp.Missing("the bag has fewer than two messages")
    yaws, variances = (
        np.concatenate([np.empty(0), *(series.values for series in window.topics[name].values())])
        for name in ("odometry", "scans")
    )
    return {
        "yaw_variance": float(np.var(yaws)) if yaws.size else fp.Missing("no odometry"),
        "range_variance": _nan_to_zero(np.mean(variances))
        if variances.size
        else fp.Missing("no scans"),
        "duration_ns": float(duration_ns),
    }


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the thesis's ten features."""
    topics = {
        "odometry": fp.Request(_wrapped_yaw, role=ODOMETRY, optional=True, many=True),
        "scans": fp.Request(range_variance, role=SCAN, optional=True, many=True),
    }
    return [
        fp.FeaturePlugin(
            "thesis_structural", "thesis", _STRUCTURAL, _compute_structural, needs_graph=True
        ),
        fp.FeaturePlugin("thesis_contextual", "thesis", _CONTEXTUAL, _compute_contextual, topics),
    ]


def _nan_to_zero(value: np.float64) -> float:
    return 0.0 if np.isnan(value) else float(value)
