"""The report for people: one HTML file that holds everything it shows and asks the network nothing.

Tables and pictures come from ``oracle_pipeline.reporting.reports``; the page itself is
``templates/report.html.j2``.
"""

import base64
import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import jinja2
import numpy as np
import pandas as pd

from oracle_pipeline.datasets import content_hash, is_malicious, replacing
from oracle_pipeline.evaluation.limits import limits
from oracle_pipeline.evaluation.metrics import RESAMPLES
from oracle_pipeline.reporting.figures import DPI
from oracle_pipeline.reporting.result import Report
from oracle_pipeline.reporting.tables import estimate

LIBRARIES = ("numpy", "scipy", "scikit-learn", "pandas", "networkx", "matplotlib", "mujoco")


class Cell(NamedTuple):
    """One cell of a table: what it says and, smaller, its interval."""

    text: str
    interval: str = ""


class Column(NamedTuple):
    """One column of a table, below a group heading."""

    title: str
    name: str  # of the DataFrame's column
    group: str = ""


class Grid(NamedTuple):
    """A table ready for the page."""

    title: str
    groups: Sequence[tuple[str, int]]  # heading, columns below it
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]


class Picture(NamedTuple):
    """A picture inside the page."""

    caption: str
    uri: str
    width: int  # [CSS px]


THESIS = "The thesis"
_AUC, _VERDICT, _BEST = "AUC", "Verdict without labels", "The thesis's reading of our runs"
_MEASURES = (
    Column("recall", "recall_best_cluster", _BEST),
    Column("FPR", "fpr_best_cluster", _BEST),
    Column("hard AUC", "balanced_accuracy_best_cluster", _BEST),
    Column("recall", "thesis_recall", THESIS),
    Column("FPR", "thesis_fpr", THESIS),
    Column("hard AUC", "thesis_auc", THESIS),
    Column("TPR", "tpr", _VERDICT),
    Column("FPR", "fpr", _VERDICT),
    Column("balanced accuracy", "balanced_accuracy", _VERDICT),
    Column("MCC", "mcc", _VERDICT),
    Column("HAC height", "auc", _AUC),
    Column("note", "note"),
)
_GRID = (Column("linkage", "linkage"), Column("criterion", "criterion"), Column("t", "t"))
_RATES = (Column("malicious rows", "malicious_rate"),)
_PAIRS = (Column("runs", "scope"), Column("features", "features"))
_EVALUATION = (
    *_PAIRS,
    Column("HAC height, held out", "auc", _AUC),
    Column("small clusters", "auc_small_clusters", _AUC),
    Column("malicious runs", "malicious"),
    Column("right runs", "right"),
    Column("note", "note"),
)

_CAPTIONS = {
    "aucs": "AUC of each feature family, each run taken once; dotted: chance",
    "grid": "Balanced accuracy of the verdict without labels; 0.5 is chance",
    "roc": "ROC curves with 95% bands from resampled blocks",
    "principal_components": "Runs in the first two principal components of all scaled features",
    "rates": "Recall and false alarms of the best cluster; equal means nothing is told apart",
    "pairs": "The thesis's AUC, of a hard verdict chosen with labels, ours and its own",
}


def render(
    df: pd.DataFrame,
    *,
    grid: Report,
    rates: Report,
    pairs: Report,
    evaluation: Report,
    runs: Mapping[str, bytes],
    provenance: Mapping[str, str],
) -> str:
    """Return the page.

    Parameters
    ----------
    df : DataFrame
        The distinct runs, a row each.
    grid, rates, pairs, evaluation : Report
        Of `clustering_grid_search`, `malicious_rate_report`, `pairwise_report` and
        `oracle_evaluation`.
    runs : mapping of str to bytes
        PNG pictures of runs from above, by caption.
    provenance : mapping of str to str
        What the report was made from and with.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("oracle_pipeline.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(
        campaign=_campaign(df),
        warnings=limits(df),
        headline=evaluation.summary["headline"],
        reading=_thesis_reading(pairs.table.iloc[0]),
        tables={
            "evaluation": _grid("Our evaluation", evaluation.table, _EVALUATION),
            "grid": _grid("Grid search", grid.table, (*_GRID, *_MEASURES)),
            "rates": _grid("Malicious rates", rates.table, (*_RATES, *_MEASURES)),
            "pairs": _grid("Pairs and features", pairs.table, (*_PAIRS, *_MEASURES)),
        },
        pictures={
            "evaluation": _charts(evaluation),
            "grid": _charts(grid),
            "trees": [*_dendrograms(grid), *_dendrograms(pairs)],
            "rates": _charts(rates),
            "pairs": _charts(pairs),
            "runs": [_picture(caption, png) for caption, png in runs.items()],
        },
        provenance={**provenance, **_draws(pairs, evaluation)},
        THESIS=THESIS,
    )


def write_page(page: str, path: Path) -> None:
    """Write a page so that a reader sees all of it or the old one."""
    with replacing(path) as sink:
        sink.write(page.encode())


def provenance(df: pd.DataFrame) -> dict[str, str]:
    """Return what every report is made from and with: the runs' hash, versions of what computed."""
    return {
        "Run features, SHA-256": content_hash(df),
        "Python": platform.python_version(),
        **{library: version(library) for library in LIBRARIES},
    }


def _campaign(df: pd.DataFrame) -> str:
    malicious = int(is_malicious(df).sum())
    return (
        f"{len(df)} runs of {df['mode'].nunique()} modes in {df['block'].nunique()} blocks and "
        f"{df['session'].nunique()} sessions: {malicious} attacked, {len(df) - malicious} right."
    )


def _draws(pairs: Report, evaluation: Report) -> dict[str, str]:
    drawn = pairs.summary
    return {
        "Bootstrap": f"{drawn['rows']} rows, share malicious {drawn['malicious_rate']}, seed "
        f"{drawn['seed']}",
        "Resampled blocks": f"{RESAMPLES} times, seed {evaluation.summary['seed']}",
    }


def _thesis_reading(row: pd.Series) -> str:
    """Say what the thesis's method, Ward and two clusters, gives on all modes and features."""
    recall, fpr = (estimate(row, f"{name}_best_cluster") for name in ("recall", "fpr"))
    return (
        f"On these runs it holds {recall} of the malicious rows and {fpr} of the others; "
        f"in the thesis {row['thesis_recall']:.3f} and {row['thesis_fpr']:.3f}."
    )


def _grid(title: str, table: pd.DataFrame, columns: Iterable[Column]) -> Grid:
    shown = [c for c in columns if c.name != "note" or table["note"].astype(bool).any()]
    groups = [(name, len(list(members))) for name, members in groupby(shown, lambda c: c.group)]
    rows = [[_cell(row, column.name) for column in shown] for _, row in table.iterrows()]
    return Grid(title, groups, shown, rows)


def _cell(row: pd.Series, name: str) -> Cell:
    value = row[name]
    if f"{name}_low" in row.index:
        text, _, interval = str(estimate(row, name)).partition(" ")
        return Cell(text, interval)
    if name == "malicious_rate":
        return Cell(f"{value:.0%}")
    if not isinstance(value, float):
        return Cell(str(value))
    if np.isnan(value):
        return Cell("")
    return Cell(
        f"{value:g}" if name == "t" else f"{value:z.2f}" if name == "mcc" else f"{value:.3f}"
    )


def _charts(report: Report) -> list[Picture]:
    return [
        _picture(text, report.figures[n]) for n, text in _CAPTIONS.items() if n in report.figures
    ]


def _dendrograms(report: Report) -> list[Picture]:
    trees = {name: png for name, png in report.figures.items() if name.startswith("dendrogram_")}
    return [_picture(name.removeprefix("dendrogram_"), png) for name, png in sorted(trees.items())]


def _picture(caption: str, png: bytes) -> Picture:
    pixels = int.from_bytes(png[16:20], "big")  # the width in a PNG's header
    uri = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    return Picture(caption, uri, round(pixels * 100 / DPI))
