"""Charts as PNG bytes: dendrogram, ROC and other curves, components, heat maps, intervals.

Maps of runs are drawn in ``oracle_pipeline.replay.scene``, all in the style of
``oracle_pipeline.reporting.figures``.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from scipy.cluster.hierarchy import leaves_list

from oracle_pipeline.clustering.tree import Tree
from oracle_pipeline.evaluation.curves import Curve
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.metrics import RocCurve
from oracle_pipeline.evaluation.splits import HARMLESS
from oracle_pipeline.reporting.figures import AMBER, COLORS, DASHES, INK, MARKERS, SERIES, drawing

SHADE = 0.3  # opacity of a heat map's strongest cell; the number on it must stay readable


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
            axes.fill_between(curve.fpr, curve.low, curve.high, color=color, alpha=0.13, lw=0)
            fpr, tpr = np.append(0.0, curve.fpr), np.append(0.0, curve.tpr)
            axes.plot(fpr, tpr, color=color, ls=dash, lw=1.8, label=f"{name}  AUC {area}")
        axes.set(xlim=(-0.01, 1.01), ylim=(-0.01, 1.01), aspect="equal")
        axes.set(xlabel="false-positive rate", ylabel="true-positive rate")
        axes.legend(loc="lower right", fontsize="small")
    return png.getvalue()


def curves(named: Mapping[str, Curve], x: str, y: str, *, log: bool = False) -> bytes:
    """Draw curves of shares with their bands.

    Parameters
    ----------
    named : mapping of str to Curve
        Curves by legend text.
    x, y : str
        Labels of the axes.
    log : bool
        Whether `x` is on a logarithmic axis.
    """
    with drawing(4.7, 3.6) as (axes, png):
        for number, (name, curve) in enumerate(named.items()):
            color, dash = SERIES[number % len(SERIES)], DASHES[number % len(DASHES)]
            if curve.low is not None and curve.high is not None:
                axes.fill_between(curve.x, curve.low, curve.high, color=color, alpha=0.13, lw=0)
            axes.plot(curve.x, curve.y, color=color, ls=dash, lw=1.8, label=name)
        axes.set(xlabel=x, ylabel=y, ylim=(-0.02, 1.02))
        if log:
            axes.set_xscale("log")
        axes.grid(True)
        axes.legend(loc="best", fontsize="small")
    return png.getvalue()


def oracle_name(row: pd.Series) -> str:
    """Name the oracle of a row of the kill matrix."""
    name = f"{row['detector']}, {row['features']}, {row['level']}"
    return f"{name}, hard negatives unseen" if row["split"] == HARMLESS else name


def kill_heat_map(kills: pd.DataFrame) -> bytes:
    """Draw the share of killed mutants for every oracle and magnitude of one operator.

    Parameters
    ----------
    kills : DataFrame
        Rows of one scenario and parameter of `kill_rates.kill_matrix`.
    """
    names = [oracle_name(row) for _, row in kills.iterrows()]
    oracles, values = list(dict.fromkeys(names)), sorted(set(kills["value"]))
    with drawing(7.2, 0.3 * len(oracles) + 1.2) as (axes, png):
        for name, (_, row) in zip(names, kills.iterrows(), strict=True):
            column, line, rate = values.index(row["value"]), oracles.index(name), row["kill_rate"]
            if np.isfinite(rate):
                cell, color = (column - 0.48, column + 0.48), COLORS["control"]
                axes.fill_between(
                    cell, line - 0.46, line + 0.46, color=color, alpha=SHADE * rate, lw=0
                )
            text = f"{rate:.2f}" if np.isfinite(rate) else "n/a"
            axes.text(column, line, text, ha="center", va="center", fontsize="small")
        axes.set_xticks(range(len(values)), [f"{value:.3g}" for value in values])
        axes.set_yticks(range(len(oracles)), oracles)
        axes.set(xlim=(-0.5, len(values) - 0.5), ylim=(len(oracles) - 0.5, -0.5))
        axes.set_xlabel(f"{kills['parameter'].iloc[0]} of {kills['scenario'].iloc[0]}")
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
    return png.getvalue()


def principal_components(
    X: NDArray[np.float64], labels: Sequence[str], copies: NDArray[np.int64] | None = None
) -> bytes:
    """Scatter runs in the first two principal components of their scaled features.

    Parameters
    ----------
    X : ndarray of shape (n, n_features)
        Scaled features.
    labels : sequence of str, length n
    copies : ndarray of shape (n,), optional
        Number of draws of each run, shown as the area of the marker.
    """
    padded = np.pad(X - X.mean(axis=0), (0, 2))  # ensures two components
    left, singular, directions = np.linalg.svd(padded, full_matrices=False)
    # A component's sign is arbitrary: make its largest loading positive.
    sign = np.sign(directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)])
    scores = (left * singular * sign)[: len(X), :2]
    shares = singular[:2] ** 2 / (float((singular**2).sum()) or 1.0)
    size = np.full(len(X), 26.0) if copies is None else 26.0 * copies / copies.mean()

    with drawing(4.7, 4.7) as (axes, png):
        for label in COLORS:
            mask = np.array([other == label for other in labels])
            if mask.any():
                axes.scatter(
                    scores[mask, 0],
                    scores[mask, 1],
                    s=size[mask],
                    color=COLORS[label],
                    marker=MARKERS[label],
                    alpha=0.7,
                    linewidths=0,
                    label=f"{label} ({mask.sum()})",
                )
        for axis, name, share in (
            (axes.xaxis, "first", shares[0]),
            (axes.yaxis, "second", shares[1]),
        ):
            axis.set_label_text(f"{name} component, {share:.0%} of the variance")
        axes.grid(True)
        _legend_above(axes)
    return png.getvalue()


def grid_heat_map(table: pd.DataFrame) -> bytes:
    """Draw the balanced accuracy of the verdict without labels for every setting of the grid.

    Parameters
    ----------
    table : DataFrame
        From ``oracle_pipeline.reporting.thesis_tables.grid_search_table``.
    """
    settings = list(dict.fromkeys(zip(table["criterion"], table["t"], strict=True)))
    names = table["linkage"] + ", " + table["metric"]
    methods = list(dict.fromkeys(names))
    with drawing(7.2, 0.62 * len(methods) + 0.8) as (axes, png):
        for (_, row), name in zip(table.iterrows(), names, strict=True):
            column = settings.index((row["criterion"], row["t"]))
            line = methods.index(name)
            area = Estimate(*(row[f"balanced_accuracy{end}"] for end in ("", "_low", "_high")))
            better = COLORS["control" if area.value >= 0.5 else "malicious"]
            strength = 0.0 if np.isnan(area.value) else 2.0 * SHADE * abs(area.value - 0.5)
            cell = (column - 0.48, column + 0.48)
            axes.fill_between(cell, line - 0.46, line + 0.46, color=better, alpha=strength, lw=0)
            axes.text(column, line, str(area), ha="center", va="center")
        axes.set_xticks(range(len(settings)), [f"{name} {t:g}" for name, t in settings])
        axes.set_yticks(range(len(methods)), methods)
        axes.set(xlim=(-0.5, len(settings) - 0.5), ylim=(len(methods) - 0.5, -0.5))
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
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
