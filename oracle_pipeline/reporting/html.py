"""The report's main page: the first screen, the evidence, and the method in folded sections.

It loads nothing from the network. Its content comes from ``evaluation_report`` and
``thesis_reports``, and the layout is ``templates/report.html.j2``. ``run_pages`` writes the pages
of runs.
"""

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import pandas as pd

from oracle_pipeline.datasets import content_hash, replacing
from oracle_pipeline.evaluation.comparisons import ALL_MODES, HARD_NEGATIVES, HEADLINE
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.metrics import RESAMPLES
from oracle_pipeline.evaluation.splits import BLOCK
from oracle_pipeline.reporting.explanation import Explanation
from oracle_pipeline.reporting.first_screen import Recorder, first_screen
from oracle_pipeline.reporting.kinds_tables import tables_of_kinds
from oracle_pipeline.reporting.searched import Searched
from oracle_pipeline.reporting.stored_report import Report
from oracle_pipeline.reporting.tables import (
    PageColumn,
    PageTable,
    evidence_table,
    plain_table,
    table,
)
from oracle_pipeline.reporting.templating import Picture, picture, run_picture, template

LIBRARIES = ("numpy", "scipy", "scikit-learn", "pandas", "networkx", "matplotlib", "mujoco")
NO_STORAGE = pd.DataFrame()
_SCORER = [*HEADLINE._fields, "split"]


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
    thesis = {
        "grid": grid,
        "rates": rates,
        "pairs": pairs,
        "side_by_side": side_by_side,
        "null_model": null_model,
    }
    return template("report.html.j2").render(
        screen=first_screen(evaluation, record),
        arrived=arrived,
        scorer=evaluation.summary["scorer"],
        checks=evaluation.tables["checks"].to_dict("records"),
        explained=[
            (
                each,
                evidence_table(f"What is unusual in {each.run_id}", each.evidence),
                [run_picture(run, png) for run, png in each.pictures.items()],
            )
            for each in explained
        ],
        searched=searched,
        tables={
            **_tables_of_evaluation(evaluation),
            **tables_of_kinds(evaluation.tables),
            **{name: table(name, report.table) for name, report in thesis.items()},
            "giveaways": _table_of_giveaways(giveaways),
            "storage": plain_table("Storage", storage),
        },
        roc={"evaluation": evaluation.figures.get("roc"), "grid": grid.figures.get("roc")},
        forest={
            "rates": rates.figures["rates"],
            "pairs": pairs.figures["pairs"],
            "side_by_side": side_by_side.figures["reproduced"],
        },
        radar=[run_picture(run, png) for run, png in radar.items()],
        trees=[*_dendrograms(grid), *_dendrograms(pairs)],
        picture=picture,
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


def _tables_of_evaluation(evaluation: Report) -> dict[str, PageTable]:
    """Return the tables of `oracle_evaluation` by name."""
    judged, further = evaluation.table, evaluation.tables
    headline = _rows(judged, **HEADLINE._asdict())
    overall = headline["scope"].isin([ALL_MODES, HARD_NEGATIVES])
    headline = headline[(headline["split"] == BLOCK) | overall]
    scopes = [scope for scope in headline["scope"] if "/" in scope]
    areas = [PageColumn(scope, scope) for scope in scopes]
    tables = {
        "verdicts": table("verdicts", headline),
        "scorers": table("scorers", _rows(judged, scope=ALL_MODES)),
        "areas": table("areas", _areas(judged, scopes), areas),
    }
    for name in ("alarms", "aspects", "aspects_by_mode", "minimum_detectable", "mutation_scores",
                 "kills"):  # fmt: skip
        if name in further:
            tables[name] = table(name, further[name])
    return tables


def _rows(table: pd.DataFrame, **values: str) -> pd.DataFrame:
    """Return the rows that have these values."""
    return table[(table[list(values)] == list(values.values())).all(axis=1)]


def _areas(judged: pd.DataFrame, scopes: Sequence[str]) -> pd.DataFrame:
    """Return one row for each scorer, with its AUC in each scope under the scope's name."""
    joined = judged[_SCORER].drop_duplicates().set_index(_SCORER)
    for scope in scopes:
        of_scope = judged[judged["scope"] == scope].set_index(_SCORER)
        for end in ("", "_low", "_high"):
            joined[f"{scope}{end}"] = of_scope[f"auc{end}"]
    return joined.reset_index()


def _table_of_giveaways(giveaways: pd.DataFrame) -> PageTable:
    """Return the features that show each attacked mode; only its first row has the mode's name."""
    text = giveaways.astype(str)
    shown = giveaways.assign(
        mode=text["mode"].mask(giveaways.duplicated("mode"), ""),
        outside=text["outside"] + " of " + text["runs"],
        normal=text["outside_normal"] + " of " + text["normal"],
    )
    return table("giveaways", shown)


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


def _dendrograms(report: Report) -> list[Picture]:
    return [
        picture(f"Dendrogram, {of}", of, png)
        for name, png in sorted(report.figures.items())
        if (of := name.removeprefix("dendrogram_")) != name
    ]
