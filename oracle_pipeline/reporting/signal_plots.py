"""Plots of the evidence of a verdict over time, against the range of normal windows.

The page draws them as inline SVG: x in thousandths of the length, y from 0 (top) to `HEIGHT`.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.scoring.sentences import clearest, rounded
from oracle_pipeline.scoring.verdict import Evidence, Verdict, WindowSeries
from oracle_pipeline.windows import WINDOW_S

SHOWN = 3
WIDTH, HEIGHT = 1000.0, 100.0
_DOT = 0.01  # of the width, for a window without neighbours


class SignalPlot(NamedTuple):
    """One feature; lengths in the units of the picture."""

    feature: str
    unit: str
    lines: Sequence[str]  # points of a line for each stretch without a missing value
    band: tuple[float, float] | None  # y and height of the normal range, if known
    evidence: tuple[float, float] | None  # x and width of the time that deviates most
    low: str  # value at the lower and at the upper end
    high: str
    words: str


def length_s(verdict: Verdict) -> float:
    """Return how much time the plots of a verdict span [s]; 0 without any."""
    starts = (start for each in verdict.series for start in each.start_s)
    return max((start + WINDOW_S for start in starts), default=0.0)


def first_evidence(verdict: Verdict) -> Evidence | None:
    """Return the evidence that the headline of a verdict tells, if there is any."""
    return clearest(verdict.evidence) if verdict.evidence else None


def signal_plots(verdict: Verdict, length: float) -> list[SignalPlot]:
    """Return the plots of the first evidence, that of the headline before the others.

    Parameters
    ----------
    verdict : Verdict
    length : float
        Time that the whole width spans [s].
    """
    of_feature = {each.feature: each for each in verdict.series}
    told = first_evidence(verdict)
    ordered = sorted(verdict.evidence, key=lambda each: each is not told)
    shown = [each for each in ordered if each.feature in of_feature][:SHOWN]
    return [_plot(each, of_feature[each.feature], length) for each in shown]


def _plot(evidence: Evidence, series: WindowSeries, length: float) -> SignalPlot:
    values = np.array([np.nan if value is None else value for value in series.values])
    normal = [end for end in (series.normal_high, series.normal_low) if end is not None]
    ends = [*values[np.isfinite(values)], *normal]
    low, high = min(ends), max(ends)
    span = high - low or 1.0

    def y(value: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.round(HEIGHT * (high - value) / span, 1), dtype=np.float64)

    x = np.round(WIDTH * (np.array(series.start_s) + WINDOW_S / 2) / length, 1)
    band = y(np.array(normal)).tolist()  # top and bottom, if known
    since, until = evidence.window_start_s, evidence.window_end_s or length
    range_ = " to ".join(rounded(end) for end in reversed(normal)) or "an unknown range"
    return SignalPlot(
        series.feature,
        "" if series.unit == "1" else series.unit,
        list(_lines(x, y(values))),
        (band[0], round(band[1] - band[0], 1)) if band else None,
        None if since is None else (WIDTH * since / length, WIDTH * (until - since) / length),
        rounded(low, 3),
        rounded(high, 3),
        f"{series.feature} over time; normal windows have {range_} {series.unit}",
    )


def _lines(x: NDArray[np.float64], y: NDArray[np.float64]) -> Iterator[str]:
    """Yield the points of each stretch of windows that follow each other and have a value."""
    known = np.flatnonzero(np.isfinite(y))
    step = 1.5 * float(np.min(np.diff(x), initial=WIDTH))
    for stretch in np.split(known, np.flatnonzero(np.diff(x[known]) > step) + 1):
        points = [f"{x[n]},{y[n]}" for n in stretch]
        if len(points) == 1:  # as a dash
            points.append(f"{x[stretch[0]] + _DOT * WIDTH},{y[stretch[0]]}")
        if points:
            yield " ".join(points)
