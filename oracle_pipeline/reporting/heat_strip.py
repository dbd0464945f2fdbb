"""A heat map of the unusual windows of a run: windows by column, families of features by row.

The page draws it as inline SVG; positions are in per cent of the width. The usual ranges come from
``oracle_pipeline.evaluation.unusual_windows``.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import CLIP
from oracle_pipeline.evaluation.unusual_windows import UnusualWindows
from oracle_pipeline.windows import HOP_S, WINDOW_S

LINE = 18  # height of a family [px]
STRONGEST = 10.0  # multiple of the usual distance at which a cell is opaque
FAINTEST = 0.25  # opacity of a cell just outside the usual range
LEAST_USUAL = 1.0  # a distance below one scale always counts as usual
TICK_S = (10, 20, 60, 120, 300, 600)  # choices of the distance between ticks
MOST_TICKS = 8


class Cell(NamedTuple):
    """One window that is outside the usual range in one family."""

    x: float  # [%]
    width: float  # [%]
    opacity: float
    words: str


class HeatRow(NamedTuple):
    """One family."""

    family: str
    y: int  # [px]
    cells: Sequence[Cell]
    usual: str


class AlarmMark(NamedTuple):
    """One alarm, at the end of the window that raised it."""

    x: float  # [%]
    words: str


class HeatStrip(NamedTuple):
    """The whole heat map."""

    rows: Sequence[HeatRow]
    height: int  # [px], without the axis
    ticks: Sequence[tuple[float, str]]
    onset: float | None  # of the attack [%]
    goals: Sequence[float]  # when goals ended [%]
    alarms: Sequence[AlarmMark]
    words: str


def heat_strip(
    windows: UnusualWindows,
    recording_s: float,
    onset_s: float | None,
    goal_ends_s: Sequence[float],
    alarms_s: Sequence[float] = (),
) -> HeatStrip:
    """Return the heat map of the windows of one run, the most unusual family first.

    A cell ends where the next window starts, so that cells do not overlap as windows do. The first
    line has the alarms.
    """
    end_s = max(recording_s, float(windows.start_s.max(initial=0.0)) + HOP_S)
    bounds = np.maximum(windows.usual, LEAST_USUAL)
    ratio = windows.distance / bounds
    outside = ratio > 1.0
    order = np.argsort(-outside.sum(axis=0), kind="stable")
    rows = [
        HeatRow(
            windows.families[family],
            LINE * (line + 1),
            _cells(windows, ratio[:, family], int(family), end_s),
            _usual(bounds[family]),
        )
        for line, family in enumerate(order)
    ]
    unusual = [windows.families[family] for family in order if outside[:, family].any()]
    number = len(outside)
    words = f"No window of {number} is outside the usual range"
    if unusual:
        some = int(outside.any(axis=1).sum())
        words = f"{some} of {number} windows outside the usual range: {', '.join(unusual)}"
    raised = "no alarm" if not alarms_s else f"alarms at {', '.join(f'{s:g} s' for s in alarms_s)}"
    return HeatStrip(
        rows,
        LINE * (len(rows) + 1),
        _ticks(end_s),
        None if onset_s is None else round(100.0 * onset_s / end_s, 2),
        [round(100.0 * goal_s / end_s, 2) for goal_s in goal_ends_s],
        [AlarmMark(round(100.0 * s / end_s, 2), _alarm(s, onset_s)) for s in alarms_s],
        f"{words}; {raised}",
    )


def _cells(
    windows: UnusualWindows, ratio: NDArray[np.float64], family: int, end_s: float
) -> list[Cell]:
    cells = []
    for window in np.flatnonzero(ratio > 1.0).tolist():
        start_s = float(windows.start_s[window])
        strength = min(1.0, np.log(ratio[window]) / np.log(STRONGEST))
        distance = float(windows.distance[window, family])
        more = " or more" if distance >= CLIP else ""
        cells.append(
            Cell(
                round(100.0 * start_s / end_s, 2),
                round(100.0 * min(HOP_S, end_s - start_s) / end_s, 2),
                round(FAINTEST + (1.0 - FAINTEST) * float(strength), 2),
                f"{start_s:g} to {min(start_s + WINDOW_S, end_s):g} s: "
                f"{windows.farthest[window, family]}, z {distance:.1f}{more}",
            )
        )
    return cells


def _alarm(at_s: float, onset_s: float | None) -> str:
    """Return a text on the time of an alarm."""
    if onset_s is None or at_s <= onset_s:
        return f"alarm at {at_s:g} s"
    return f"alarm at {at_s:g} s, {at_s - onset_s:.0f} s after the attack began"


def _usual(bound: float) -> str:
    return "no value" if np.isnan(bound) else f"\N{LESS-THAN OR EQUAL TO} {bound:.1f}"


def _ticks(end_s: float) -> list[tuple[float, str]]:
    step = next((each for each in TICK_S if end_s / each <= MOST_TICKS), TICK_S[-1])
    return [
        (round(100.0 * time_s / end_s, 2), f"{time_s:g}")
        for time_s in range(0, int(end_s) + 1, step)
    ]
