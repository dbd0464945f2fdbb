"""A plot with a line for each mode and a mark for each run, by score.

The page draws it as inline SVG in its own colours, so that it is readable in light and dark mode
and text keeps its size on a phone. Positions are in per cent of the width.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.evaluation.card_verdicts import RATE

MARGIN = 2.5  # left and right of the marks [%]
TICK_DISTANCE = 8.0  # least distance of two ticks [%]
TICKS = (0, 1, 3, 10, 30, 100, 300, 1000, 3000, 10_000)
HEIGHTS = ((10, 26), (20, 19))  # largest number of modes, height of their lines [px]
LEAST_HEIGHT = 14  # with more modes
JITTER = (0, -1, 1, -2, 2)  # vertical offsets, so that equal scores do not hide each other


class _Mark(NamedTuple):
    """One run."""

    x: float  # [%]
    y: float  # [px]
    page: str
    name: str  # run and score, as text
    called: bool  # anomalous; also true without verdicts


class _Strip(NamedTuple):
    """The runs of one mode."""

    mode: str
    label: str
    marks: Sequence[_Mark]
    note: str  # number of runs
    description: str


class StripPlot(NamedTuple):
    """The whole plot."""

    strips: Sequence[_Strip]
    height: int  # of a line [px]
    ticks: Sequence[tuple[float, str]]  # position [%] and text
    highest_normal: float | None  # [%]
    with_verdicts: bool


def strip_plot(
    runs: pd.DataFrame, standing: pd.DataFrame, page_of: Callable[[str], str]
) -> StripPlot | None:
    """Return the plot; None if no run has a score.

    Parameters
    ----------
    runs : DataFrame
        The table ``runs`` of `oracle_evaluation`.
    standing : DataFrame
        Modes, in the order of their lines (`oracle_pipeline.evaluation.ranking.standing`).
    page_of : callable
        Takes a run and returns the address of its page.
    """
    runs = runs[np.isfinite(runs["score"])]
    if runs.empty:
        return None
    place = _Scale(runs["score"])
    height = next((px for modes, px in HEIGHTS if len(standing) <= modes), LEAST_HEIGHT)
    with_verdicts = bool(runs["p"].notna().any())
    strips = []
    for _, mode in standing.iterrows():
        of_mode = runs[runs["mode"] == mode["mode"]]
        marks = [
            _Mark(
                round(place(run.score), 2),
                height / 2 + JITTER[number % len(JITTER)] * height / 10,
                page_of(run.run_id),
                f"{run.run_id}: {run.score:.3g}",
                bool(run.p <= RATE) or not with_verdicts,
            )
            for number, run in enumerate(of_mode.itertuples())
        ]
        description = _description(mode, of_mode)
        strips.append(_Strip(mode["mode"], mode["label"], marks, str(mode["runs"]), description))
    normal = runs.loc[~is_malicious(runs), "score"]
    highest = None if normal.empty else round(place(normal.max()), 2)
    return StripPlot(strips, height, place.ticks(), highest, with_verdicts)


def _description(mode: pd.Series, runs: pd.DataFrame) -> str:
    """Return a text alternative for a line of the plot."""
    span = ""
    if len(runs):
        span = f", scores from {runs['score'].min():.3g} to {runs['score'].max():.3g}"
    called = f", {mode['called']} of {mode['judged']} called anomalous" if mode["judged"] else ""
    return f"{mode['mode']}: {mode['runs']} {mode['label']} runs{span}{called}"


class _Scale:
    """Maps scores to positions: linear near 0, logarithmic far from it (asinh)."""

    def __init__(self, scores: pd.Series) -> None:
        self._low, self._high = np.arcsinh([min(scores.min(), -1.0), max(scores.max(), 3.0)])

    def __call__(self, score: float) -> float:
        share = (np.arcsinh(score) - self._low) / (self._high - self._low)
        return float(MARGIN + share * (100.0 - 2 * MARGIN))

    def ticks(self) -> list[tuple[float, str]]:
        """Return positions and texts of the ticks."""
        named: list[tuple[float, str]] = []
        for tick in TICKS:
            x = self(tick)
            if x <= 100.0 - MARGIN / 2 and (not named or x - named[-1][0] >= TICK_DISTANCE):
                named.append((round(x, 2), f"{tick:,}"))
        return named
