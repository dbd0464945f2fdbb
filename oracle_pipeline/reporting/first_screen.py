"""The first screen of the report: recorded runs, results, and open claims.

It computes no results; all come from ``oracle_evaluation``.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.reporting.report import Report
from oracle_pipeline.reporting.strip_plot import StripPlot, strip_plot
from oracle_pipeline.reporting.two_scores import called_kinds, counted, true_kinds

HIGHEST = 3  # number of runs with the highest scores to list

# Takes modes, with a trailing ``*`` as wildcard, and blocks; returns the command that records them.
Recorder = Callable[[Sequence[str], int], str]


class RunLink(NamedTuple):
    """A run and its page."""

    run: str
    page: str  # relative to the folder of the report
    score: str


class ClaimLine(NamedTuple):
    """A claim that these runs do not support yet."""

    claim: str
    reason: str
    command: str  # empty: more runs do not help


class FirstScreen(NamedTuple):
    """The content of the first screen."""

    answer: str
    recorded: str
    verdicts: str
    by_scores: str  # number of runs that the two scores call tampered and misbehaved; may be empty
    in_truth: str  # number of runs that are
    highest: Sequence[RunLink]
    highest_normal: RunLink | None
    claims: Sequence[ClaimLine]
    plot: StripPlot | None


def first_screen(evaluation: Report, record: Recorder) -> FirstScreen:
    """Return the first screen of an evaluation's report."""
    runs = evaluation.tables["runs"]
    scored = runs[np.isfinite(runs["score"])].sort_values("score", ascending=False)
    return FirstScreen(
        answer=str(evaluation.summary["headline"]),
        recorded=_recorded(runs, int(evaluation.summary["left_out"])),
        verdicts=str(evaluation.summary["verdicts"]),
        by_scores=counted(called_kinds(runs)),
        in_truth=counted(true_kinds(runs)),
        highest=_links(scored.head(HIGHEST)),
        highest_normal=next(iter(_links(scored[~is_malicious(scored)].head(1))), None),
        claims=[
            ClaimLine(
                row["claim"],
                row["reason"],
                record(row["modes"].split(), row["blocks"]) if row["blocks"] else "",
            )
            for _, row in evaluation.tables["open_claims"].iterrows()
        ],
        plot=strip_plot(runs, evaluation.tables["standing"], run_page),
    )


def run_page(run: str) -> str:
    """Return the page of a run, relative to the folder of the report.

    Examples
    --------
    >>> run_page("fake_object|run003")
    'runs/fake_object/run003.html'
    """
    return f"runs/{run.replace('|', '/')}.html"


def _links(runs: pd.DataFrame) -> list[RunLink]:
    return [
        RunLink(run["run_id"], run_page(run["run_id"]), f"{run['score']:.3g}")
        for _, run in runs.iterrows()
    ]


def _recorded(runs: pd.DataFrame, left_out: int) -> str:
    """Return sentences on the number of runs, modes and hours."""
    attacked = int(is_malicious(runs).sum())
    hours = runs["recording_s"].sum() / 3600.0
    of = [
        _count(runs["mode"].nunique(), "mode"),
        _count(runs["block"].nunique(), "block"),
        _count(runs["session"].nunique(), "session"),
        _count(runs["world"].nunique(), "world"),
    ]
    rest = f" {_count(left_out, 'more run')} ended before the onset: left out." if left_out else ""
    return (
        f"{_count(len(runs), 'run')}: {attacked} attacked, {len(runs) - attacked} normal. "
        f"{', '.join(of)}, {hours:.1f} hours.{rest}"
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
