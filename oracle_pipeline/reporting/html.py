"""The report's main page: the first screen, the evidence, and the method in folded sections.

It loads nothing from the network. Its content comes from ``evaluation_report`` and
``thesis_reports``; ``first_screen`` assembles the first screen and ``page_tables`` selects the
tables. The template is ``templates/report.html.j2``. ``run_pages`` writes the pages of runs.
"""

import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from oracle_pipeline.datasets import content_hash, replacing
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.metrics import RESAMPLES
from oracle_pipeline.reporting import page_tables
from oracle_pipeline.reporting.explanation import Explanation
from oracle_pipeline.reporting.first_screen import Recorder, first_screen, run_page
from oracle_pipeline.reporting.oracle_kinds import tables_of_kinds
from oracle_pipeline.reporting.page import Picture, picture, run_picture, template
from oracle_pipeline.reporting.page_tables import PageTable
from oracle_pipeline.reporting.report import Report
from oracle_pipeline.reporting.searched import Searched

LIBRARIES = ("numpy", "scipy", "scikit-learn", "pandas", "networkx", "matplotlib", "mujoco")
NO_STORAGE = pd.DataFrame()


class CheckLine(NamedTuple):
    """One integrity check, as text."""

    name: str
    status: str  # green, red or unsupported
    sentence: str


class ExplainedRun(NamedTuple):
    """One run explained."""

    run_id: str
    page: str
    verdict: str
    table: PageTable
    notes: Sequence[str]
    pictures: Sequence[Picture]


# Anchor and heading of each section.
_SECTIONS = {
    "verdicts": "What is detected",
    "giveaways": "Features that show each attack",
    "explained": "Attacked runs explained",
    "searched": "Attacks that a search found",
    "alarms": "Time to detect",
    "curves": "Detection against false alarms",
    "integrity": "Integrity checks",
    "scorers": "Detectors and families of features",
    "kinds": "Kinds of oracle side by side",
    "magnitude": "How weak an attack is still detected",
    "effort": "Inspection effort",
    "radar": "A radar display with and without a ghost",
    "trees": "Dendrograms",
    "thesis": "The thesis's method on these runs",
    "storage": "Storage",
    "reading": "How to read this",
    "provenance": "Provenance",
}

# Title and caption, by the name of a figure or the part before its first underscore.
_CAPTIONS = {
    "roc": ("ROC curves", "ROC curves with 95% bands from resampled blocks; dotted: chance"),
    "detection": (
        "Detection rate over false positive rate",
        "Share of runs called anomalous over the nominal false positive rate, with 95% bands; "
        "normal runs should lie on or below the nominal rate",
    ),
    "effort": (
        "Effort curve",
        "Attacks found by inspecting the most suspicious runs first",
    ),
    "kills": ("Kill matrix", "Kill matrix: share of mutants that each oracle calls anomalous"),
    "magnitude": (
        "Detection rate over magnitude",
        "Detection rate over the magnitude of the attack, by family, with 95% intervals",
    ),
    "grid": (
        "Heat map of the grid search",
        "Balanced accuracy of the verdict without labels; 0.5 is chance",
    ),
    "rates": (
        "Recall and false alarms by share of malicious rows",
        "Recall and false alarms of the best cluster; equal rates mean no separation",
    ),
    "pairs": (
        "AUC by pair and features",
        "The thesis's AUC, of a hard verdict chosen with labels, ours and its own",
    ),
    "reproduced": (
        "AUC of the thesis, reproduced and printed",
        "The thesis's AUC: reproduced on our runs, and as printed",
    ),
}


def render(
    *,
    evaluation: Report,
    explained: Sequence[Explanation],
    giveaways: pd.DataFrame,
    record: Recorder,
    grid: Report,
    rates: Report,
    pairs: Report,
    side_by_side: Report,
    null_model: Report,
    radar: Mapping[str, bytes],
    provenance: Mapping[str, str],
    storage: pd.DataFrame = NO_STORAGE,
    arrived: str = "",
    searched: Searched | None = None,
) -> str:
    """Return the page.

    Parameters
    ----------
    evaluation : Report
        From `oracle_pipeline.reporting.evaluation_report`.
    explained : sequence of Explanation
        Attacked runs, each with its evidence.
    giveaways : DataFrame
        From `oracle_pipeline.evaluation.giveaways`.
    record : callable
        Returns the command that records further runs.
    grid, rates, pairs, side_by_side, null_model : Report
        From the functions of ``oracle_pipeline.reporting.thesis_reports``.
    radar : mapping of str to bytes
        PNG pictures of an attacked air traffic run and its control, by run; may be empty.
    provenance : mapping of str to str
        Hash of the runs and versions of the libraries.
    storage : DataFrame
        Storage used by each mode.
    arrived : str
        A sentence on recordings from the inbox, which have a page of their own.
    searched : Searched, optional
        Results of searches for attacks.
    """
    tables = {
        **page_tables.of_evaluation(evaluation),
        **tables_of_kinds(evaluation),
        **page_tables.of_thesis(
            grid_search=grid,
            rates=rates,
            pairs=pairs,
            side_by_side=side_by_side,
            null_model=null_model,
        ),
        "giveaways": page_tables.of_giveaways(giveaways),
        "storage": page_tables.of_any("Storage", storage),
    }
    content = {
        "giveaways": len(giveaways) > 0,
        "curves": _charts(evaluation, "roc", "detection"),
        "kinds": "oracle_kinds" in tables,
        "magnitude": "kills" in tables,
        "explained": [_explained(each) for each in explained],
        "radar": [run_picture(run, png) for run, png in radar.items()],
        "trees": [*_dendrograms(grid), *_dendrograms(pairs)],
        "storage": len(storage) > 0,
        "searched": searched,
    }
    return template("report.html.j2").render(
        screen=first_screen(evaluation, record),
        arrived=arrived,
        scorer=evaluation.summary["scorer"],
        checks=_checks(evaluation),
        sections={name: title for name, title in _SECTIONS.items() if content.get(name, True)},
        content=content,
        tables=tables,
        charts={
            "magnitude": _charts(evaluation, "kills", "magnitude"),
            "effort": _charts(evaluation, "effort"),
            "side_by_side": _charts(side_by_side, "reproduced"),
            "grid": _charts(grid, "grid", "roc"),
            "rates": _charts(rates, "rates"),
            "pairs": _charts(pairs, "pairs"),
        },
        warning=side_by_side.summary["warning"],
        null_headline=null_model.summary["headline"],
        reading=_thesis_reading(pairs.table.iloc[0]),
        provenance={**provenance, **_draws(pairs, evaluation)},
    )


def write_page(page: str, path: Path) -> None:
    """Write a page atomically."""
    with replacing(path) as sink:
        sink.write(page.encode())


def provenance(df: pd.DataFrame) -> dict[str, str]:
    """Return the hash of the runs and the versions of the libraries that computed the report."""
    return {
        "Run features, SHA-256": content_hash(df),
        "Python": platform.python_version(),
        **{library: version(library) for library in LIBRARIES},
    }


def _checks(evaluation: Report) -> list[CheckLine]:
    return [
        CheckLine(row["name"].replace("_", " "), row["status"], row["sentence"])
        for _, row in evaluation.tables["checks"].iterrows()
    ]


def _draws(pairs: Report, evaluation: Report) -> dict[str, str]:
    settings = pairs.summary
    return {
        "Bootstrap": f"{settings['rows']} rows, share malicious {settings['malicious_rate']}, seed "
        f"{settings['seed']}",
        "Resampled blocks": f"{RESAMPLES} times, seed {evaluation.summary['seed']}",
    }


def _thesis_reading(row: pd.Series) -> str:
    """Describe the result of the thesis's method, Ward and two clusters, on all modes."""
    recall, fpr = (Estimate.of_row(row, f"{name}_best_cluster") for name in ("recall", "fpr"))
    return (
        f"On these runs it contains {recall} of the malicious rows and {fpr} of the others; "
        f"in the thesis {row['thesis_recall']:.3f} and {row['thesis_fpr']:.3f}."
    )


def _explained(explanation: Explanation) -> ExplainedRun:
    return ExplainedRun(
        explanation.run_id,
        run_page(explanation.run_id),
        explanation.verdict,
        page_tables.of_explanation(explanation),
        explanation.notes,
        [run_picture(run, png) for run, png in explanation.pictures.items()],
    )


def _charts(report: Report, *kinds: str) -> list[Picture]:
    """Return a report's figures of some kinds; names after the underscore go into the captions."""
    charts = []
    for kind in kinds:
        alt, caption = _CAPTIONS[kind]
        for name in _named(report.figures, kind):
            which = name.removeprefix(kind).lstrip("_").replace("_", " ")
            detail = f": {which}" if which else ""
            charts.append(picture(f"{alt}{detail}", f"{caption}{detail}", report.figures[name]))
    return charts


def _named(figures: Iterable[str], kind: str) -> list[str]:
    return [name for name in figures if name == kind or name.startswith(f"{kind}_")]


def _dendrograms(report: Report) -> list[Picture]:
    kind = "dendrogram_"
    names = sorted(name for name in report.figures if name.startswith(kind))
    return [
        picture(f"Dendrogram, {of}", of, report.figures[f"{kind}{of}"])
        for of in (name.removeprefix(kind) for name in names)
    ]
