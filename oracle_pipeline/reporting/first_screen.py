"""The first screen of the report: recorded runs, results, and open claims.

It computes no results; all come from ``oracle_evaluation``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.reporting.stored_report import Report
from oracle_pipeline.reporting.strip_plot import StripPlot, strip_plot
from oracle_pipeline.reporting.templating import run_page

HIGHEST = 3  # number of runs with the highest scores to list

# Takes modes and blocks; returns the command that records them.
Recorder = Callable[[Sequence[str], int], str]
Row = Mapping[Any, Any]  # of a table, by column


@dataclass(frozen=True, eq=False, slots=True)
class FirstScreen:
    """The content of the first screen."""

    answer: str
    recorded: str
    verdicts: str
    highest: Sequence[Row]  # runs
    highest_normal: Row | None
    claims: Sequence[tuple[Row, str]]  # not supported yet; and the command that would help, if any
    plot: StripPlot | None


def first_screen(evaluation: Report, record: Recorder) -> FirstScreen:
    """Return the first screen of an evaluation's report."""
    runs, claims = evaluation.tables["runs"], evaluation.tables["open_claims"]
    scored = runs[np.isfinite(runs["score"])].sort_values("score", ascending=False)
    return FirstScreen(
        answer=str(evaluation.summary["headline"]),
        recorded=_recorded(runs, int(evaluation.summary["left_out"])),
        verdicts=str(evaluation.summary["verdicts"]),
        highest=scored.head(HIGHEST).to_dict("records"),
        highest_normal=next(iter(scored[~is_malicious(scored)].to_dict("records")), None),
        claims=[
            (claim, record(claim["modes"].split(), claim["blocks"]) if claim["blocks"] else "")
            for claim in claims.to_dict("records")
        ],
        plot=strip_plot(runs, evaluation.tables["standing"], run_page),
    )


def _recorded(runs: pd.DataFrame, left_out: int) -> str:
    """Return sentences on the number of runs, modes and hours."""
    attacked = int(is_malicious(runs).sum())
    hours = runs["recording_s"].sum() / 3600.0
    of = [_count(runs[noun].nunique(), noun) for noun in ("mode", "block", "session", "world")]
    rest = f" {_count(left_out, 'more run')} ended before the onset: left out." if left_out else ""
    return (
        f"{_count(len(runs), 'run')}: {attacked} attacked, {len(runs) - attacked} normal. "
        f"{', '.join(of)}, {hours:.1f} hours.{rest}"
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
