"""Charts as PNG bytes: dendrogram, ROC curves, intervals.

Maps of runs are drawn in ``oracle_pipeline.replay.scene``, all in the style of
``oracle_pipeline.reporting.figures``.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from scipy.cluster.hierarchy import leaves_list

from oracle_pipeline.clustering.tree import Tree
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.metrics import RocCurve
from oracle_pipeline.reporting.figures import AMBER, COLORS, DASHES, INK, SERIES, drawing


def _legend_above(axes: Axes) -> None:
    axes.figure.legend(loc="outside upper right", ncols=4)


def dendrogram(tree: Tree, labels: Sequence[str]) -> bytes:
    """Draw a dendrogram; links over runs of one label have its colour, mixed ones are grey.

    Parameters
    ----------
    tree : Tree
        Over n rows.
    labels : sequence of str, length n
        ``normal``, ``control`` or ``malicious``.
    """
    n = len(tree)
    order = leaves_list(tree.merges).tolist()
    x, height = np.empty(2 * n - 1), np.concatenate([np.zeros(n), tree.merges[:, 2]])
    x[order] = np.arange(n)
    kind = [*labels, *[""] * (n - 1)]
    links, colors = [], []
    for node, (left, right) in enumerate(tree.merges[:, :2].astype(int).tolist(), start=n):
        x[node] = (x[left] + x[right]) / 2.0
        kind[node] = kind[left] if kind[left] == kind[right] else ""
        top = height[node]
        links.append(
            [(x[left], height[left]), (x[left], top), (x[right], top), (x[right], height[right])]
        )
        colors.append(COLORS.get(kind[node], INK))

    with drawing(4.7, 3.2) as (axes, png):
        axes.add_collection(LineCollection(links, colors=colors, linewidths=0.8))
        strip = np.array([[to_rgb(COLORS[labels[leaf]]) for leaf in order]])
        tallest = max(float(height[-1]), 1e-12)
        extent = (-0.5, n - 0.5, -0.07 * tallest, -0.02 * tallest)
        axes.imshow(strip, extent=extent, aspect="auto", interpolation="nearest")
        axes.set(xlim=(-0.5, n - 0.5), ylim=(-0.07 * tallest, 1.03 * tallest))
        axes.set(xticks=[], xlabel=f"{n} rows", ylabel=f"{tree.method} height")
        axes.spines["bottom"].set_visible(False)
        present = [label for label in COLORS if label in set(labels)]
        for label, color in [*((label, COLORS[label]) for label in present), ("mixed", INK)]:
            axes.plot([], [], color=color, lw=3, label=label)
        _legend_above(axes)
    return png.getvalue()


def roc_curves(curves: Mapping[str, tuple[RocCurve, Estimate]]) -> bytes:
    """Draw ROC curves with their bands; the legend gives each AUC with its interval."""
    with drawing(4.7, 4.7) as (axes, png):
        axes.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
        for number, (name, (curve, area)) in enumerate(curves.items()):
            color, dash = SERIES[number % len(SERIES)], DASHES[number % len(DASHES)]
            axes.fill_between(curve.fpr, curve.low, curve.high, color=color, alpha=0.2, lw=0.8)
            fpr, tpr = np.append(0.0, curve.fpr), np.append(0.0, curve.tpr)
            axes.plot(fpr, tpr, color=color, ls=dash, lw=1.8, label=f"{name}  AUC {area}")
        axes.set(xlim=(-0.01, 1.01), ylim=(-0.01, 1.01), aspect="equal")
        axes.set(xlabel="false-positive rate", ylabel="true-positive rate")
        axes.legend(loc="lower right", fontsize="small")
    return png.getvalue()


def intervals(
    ours: Mapping[str, Estimate],
    thesis: Mapping[str, float],
    quantity: str = "AUC",
    chance: float | None = 0.5,
) -> bytes:
    """Draw a forest plot of estimates with their intervals, and the thesis's values if known.

    Parameters
    ----------
    ours : mapping of str to Estimate
        By name of the line, from top to bottom.
    thesis : mapping of str to float
        By the same names; some may be absent.
    quantity : str
        Label of the axis, which runs from 0 to 1.
    chance : float, optional
        Where to draw a dotted line.
    """
    names = list(ours)
    with drawing(7.2, 0.3 * len(names) + 1.0) as (axes, png):
        if chance is not None:
            axes.axvline(chance, color=INK, lw=0.8, ls=":")
        lines = range(len(names))
        blue, areas = COLORS["normal"], list(ours.values())
        axes.hlines(lines, [a.low for a in areas], [a.high for a in areas], color=blue, lw=1.6)
        values = [a.value for a in areas]
        axes.plot(values, lines, "o", color=blue, ms=6, label="ours, 95% interval")
        beside = [(thesis[name], line) for line, name in enumerate(names) if name in thesis]
        if beside:
            axes.plot(*zip(*beside, strict=True), "D", color=AMBER, mfc="none", label="thesis")
        _legend_above(axes)
        axes.set(xlim=(-0.02, 1.02), ylim=(len(names) - 0.5, -0.5), xlabel=quantity)
        axes.set_yticks(range(len(names)), names)
        axes.grid(True, axis="x")
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
    return png.getvalue()
