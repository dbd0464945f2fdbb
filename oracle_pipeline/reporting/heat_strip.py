"""A heat map of the unusual windows of a run: windows by column, families of features by row.

The page draws it as inline SVG; positions are in per cent of the width. The usual ranges come from
``oracle_pipeline.evaluation.unusual_windows``.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oracle_pipeline.clustering.scaling import CLIP
from oracle_pipeline.evaluation.unusual_windows import UnusualWindows
from oracle_pipeline.windows import HOP_S, WINDOW_S

STRONGEST = 10.0  # multiple of the usual distance at which a cell is opaque
FAINTEST = 0.25  # opacity of a cell just outside the usual range
LEAST_USUAL = 1.0  # a distance below one scale always counts as usual
TICK_S = (10, 20, 60, 120, 300, 600)  # choices of the distance between ticks
MOST_TICKS = 8


class _HeatCell(NamedTuple):
    """One window that is outside the usual range in one family."""

    x: float  # [%]
    width: float  # [%]
    opacity: float
    words: str


class _HeatRow(NamedTuple):
    """One family."""

    family: str
    cells: Sequence[_HeatCell]
    usual: str


class HeatStrip(NamedTuple):
    """The whole heat map; times are positions [%]."""

    rows: Sequence[_HeatRow]
    ticks: Sequence[tuple[float, str]]
    onset: float | None  # of the attack
    goals: Sequence[float]  # when goals ended
    alarms: Sequence[tuple[float, str]]  # each at the end of the window that raised it
    words: str


def heat_strip(
    windows: UnusualWindows,
    recording_s: float,
    onset_s: float | None,
    goal_ends_s: Sequence[float],
    alarms_s: Sequence[float] = (),
) -> HeatStrip:
    """Return the heat map of the windows of one run, the most unusual family first."""
    end_s = max(recording_s, float(windows.start_s.max(initial=0.0)) + HOP_S)
    bounds = np.maximum(windows.usual, LEAST_USUAL)
    outside = windows.distance > bounds
    order = np.argsort(-outside.sum(axis=0), kind="stable").tolist()
    step = next((each for each in TICK_S if end_s / each <= MOST_TICKS), TICK_S[-1])

    def at(time_s: float) -> float:
        return round(100.0 * time_s / end_s, 2)

    return HeatStrip(
        rows=[
            _HeatRow(
                windows.families[family],
                _cells(windows, family, float(bounds[family]), end_s),
                _usual(float(bounds[family])),
            )
            for family in order
        ],
        ticks=[(at(time_s), f"{time_s:g}") for time_s in range(0, int(end_s) + 1, step)],
        onset=None if onset_s is None else at(onset_s),
        goals=[at(goal_s) for goal_s in goal_ends_s],
        alarms=[(at(alarm_s), _alarm(alarm_s, onset_s)) for alarm_s in alarms_s],
        words=_words([windows.families[f] for f in order if outside[:, f].any()],
                     int(outside.any(axis=1).sum()), len(outside), alarms_s),
    )  # fmt: skip


def _cells(windows: UnusualWindows, family: int, bound: float, end_s: float) -> list[_HeatCell]:
    """Return the unusual windows of a family.

    A cell ends where the next window starts, so that cells do not overlap as windows do.
    """
    cells = []
    for window in np.flatnonzero(windows.distance[:, family] > bound).tolist():
        start_s = float(windows.start_s[window])
        distance = float(windows.distance[window, family])
        strength = min(1.0, float(np.log(distance / bound) / np.log(STRONGEST)))
        more = " or more" if distance >= CLIP else ""
        cells.append(
            _HeatCell(
                round(100.0 * start_s / end_s, 2),
                round(100.0 * min(HOP_S, end_s - start_s) / end_s, 2),
                round(FAINTEST + (1.0 - FAINTEST) * strength, 2),
                f"{start_s:g} to {min(start_s + WINDOW_S, end_s):g} s: "
                f"{windows.farthest[window, family]}, z {distance:.1f}{more}",
            )
        )
    return cells


def _words(unusual: Sequence[str], some: int, number: int, alarms_s: Sequence[float]) -> str:
    """Return a text alternative: the unusual families, and the times of alarms."""
    words = f"No window of {number} is outside the usual range"
    if unusual:
        words = f"{some} of {number} windows outside the usual range: {', '.join(unusual)}"
    raised = f"alarms at {', '.join(f'{s:g} s' for s in alarms_s)}" if alarms_s else "no alarm"
    return f"{words}; {raised}"


def _alarm(at_s: float, onset_s: float | None) -> str:
    """Return a text on the time of an alarm."""
    if onset_s is None or at_s <= onset_s:
        return f"alarm at {at_s:g} s"
    return f"alarm at {at_s:g} s, {at_s - onset_s:.0f} s after the attack began"


def _usual(bound: float) -> str:
    return "no value" if np.isnan(bound) else f"\N{LESS-THAN OR EQUAL TO} {bound:.1f}"
