"""The report's main page: the first screen, the evidence, and the method in folded sections.

It loads nothing from the network. Its content comes from ``evaluation_report`` and
``thesis_reports``, and the layout is ``templates/report.html.j2``. ``run_pages`` writes the pages
of runs.
"""

import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from oracle_pipeline.bags.terminal import count_of
from oracle_pipeline.datasets import content_hash, is_malicious, replacing
from oracle_pipeline.evaluation.comparisons import ALL_MODES, HARD_NEGATIVES, HEADLINE
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.metrics import RESAMPLES
from oracle_pipeline.evaluation.splits import BLOCK
from oracle_pipeline.reporting.searched import Searched
from oracle_pipeline.reporting.stored_report import Report
from oracle_pipeline.reporting.strip_plot import strip_plot
from oracle_pipeline.reporting.tables import PageTable, plain_table, table
from oracle_pipeline.reporting.templating import run_page, template

LIBRARIES = ("numpy", "scipy", "scikit-learn", "pandas", "networkx", "matplotlib", "mujoco")
NO_STORAGE = pd.DataFrame()
HIGHEST = 3  # number of runs with the highest scores to list

# Takes modes and blocks; returns the command that records them.
Recorder: TypeAlias = Callable[[Sequence[str], int], str]


def render(
    *,
    evaluation: Report,
    record: Recorder,
    grid: Report,
    rates: Report,
    pairs: Report,
    side_by_side: Report,
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
    record : callable
        Returns the command that records further runs.
    grid, rates, pairs, side_by_side : Report
        From the functions of ``oracle_pipeline.reporting.thesis_reports``.
    provenance : mapping of str to str
        Hash of the runs and versions of the libraries.
    storage : DataFrame
        Storage used by each mode.
    arrived : str
        A sentence on recordings from the inbox, which have a page of their own.
    searched : Searched, optional
        Results of searches for attacks.
    """
    thesis = {"grid": grid, "rates": rates, "pairs": pairs, "side_by_side": side_by_side}
    return template("report.html.j2").render(
        screen=_first_screen(evaluation, record),
        arrived=arrived,
        scorer=evaluation.summary["scorer"],
        checks=evaluation.tables["checks"].to_dict("records"),
        searched=searched,
        tables={
            **_tables_of_evaluation(evaluation),
            **{name: table(name, report.table) for name, report in thesis.items()},
            "storage": plain_table("Storage", storage),
        },
        warning=side_by_side.summary["warning"],
        reading=_thesis_reading(pairs.table.iloc[0]),
        provenance={**provenance, **_draws(pairs, evaluation)},
    )


def _first_screen(evaluation: Report, record: Recorder) -> dict[str, Any]:
    """Return what the first screen shows: recorded runs, results, and open claims."""
    runs, claims = evaluation.tables["runs"], evaluation.tables["open_claims"]
    scored = runs[np.isfinite(runs["score"])].sort_values("score", ascending=False)
    return {
        "answer": evaluation.summary["headline"],
        "recorded": _recorded(runs, int(evaluation.summary["left_out"])),
        "verdicts": evaluation.summary["verdicts"],
        "highest": scored.head(HIGHEST).to_dict("records"),
        "highest_normal": next(iter(scored[~is_malicious(scored)].to_dict("records")), None),
        "claims": [
            (claim, record(claim["modes"].split(), claim["blocks"]) if claim["blocks"] else "")
            for claim in claims.to_dict("records")
        ],
        "plot": strip_plot(runs, evaluation.tables["standing"], run_page),
    }


def _recorded(runs: pd.DataFrame, left_out: int) -> str:
    """Return sentences on the number of runs, modes and hours."""
    attacked = int(is_malicious(runs).sum())
    hours = runs["recording_s"].sum() / 3600.0
    of = [count_of(runs[noun].nunique(), noun) for noun in ("mode", "block", "session", "world")]
    more = count_of(left_out, "more run")
    rest = f" {more} ended before the onset: left out." if left_out else ""
    return (
        f"{count_of(len(runs), 'run')}: {attacked} attacked, {len(runs) - attacked} normal. "
        f"{', '.join(of)}, {hours:.1f} hours.{rest}"
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
    of_cards = judged["detector"] == HEADLINE
    overall = judged["scope"].isin([ALL_MODES, HARD_NEGATIVES])
    tables = {
        "verdicts": table("verdicts", judged[of_cards & ((judged["split"] == BLOCK) | overall)]),
        "scorers": table("scorers", judged[(judged["scope"] == ALL_MODES)]),
    }
    for name in ("alarms", "aspects", "minimum_detectable", "mutation_scores", "kills"):
        if name in further:
            tables[name] = table(name, further[name])
    return tables


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
