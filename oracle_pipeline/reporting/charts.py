"""Dendrograms as PNG bytes.

Maps of runs are drawn in ``oracle_pipeline.replay.scene``, all in the style of
``oracle_pipeline.reporting.figures``.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from scipy.cluster.hierarchy import leaves_list

from oracle_pipeline.clustering.tree import Tree
from oracle_pipeline.reporting.figures import COLORS, INK, drawing


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
        axes.figure.legend(loc="outside upper right", ncols=4)
    return png.getvalue()
