"""The features of a recording that are farthest from normal runs, with place and time."""

import json
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import WHERE, WINDOW_START, topic_of_signal
from oracle_pipeline.detectors import Deviation, SignalScaler, UsualRanges
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.run_scorer import NormalRange
from oracle_pipeline.scoring.verdict import Evidence, WindowSeries
from oracle_pipeline.windows import HOP_S, WINDOW_S

SHOWN = 5  # features listed with a verdict
_STILL_FAR = 0.5  # share of the largest distance down to which a change lasts


def usual_ranges(
    normal: pd.DataFrame,
    features: Sequence[str],
    signals: Sequence[str],
    floors: Mapping[str, float],
) -> list[UsualRanges]:
    """Return the usual values of some features and signals among normal runs."""
    some = ((features, None), (signals, SignalScaler(floors)))
    return [UsualRanges(normal, columns, scaler) for columns, scaler in some if columns]


def ranked_deviations(usual: Sequence[UsualRanges], run: pd.DataFrame) -> list[Deviation]:
    """Return what is outside its usual range, the farthest first, be it a feature or a signal."""
    found = [each for ranges in usual for each in ranges.deviations(run)]
    return sorted(found, key=lambda each: -abs(each.z))


def farthest_features(
    deviations: Sequence[Deviation],
    tables: FeatureTables,
    normal: Mapping[str, NormalRange] | None = None,
) -> tuple[Evidence, ...]:
    """Return the first few of a recording's ranked deviations, with place and time.

    Of the statistics of a signal, only the first counts, and the first that windows have.

    Parameters
    ----------
    deviations : sequence of Deviation
    tables : FeatureTables
    normal : mapping of str to NormalRange, optional
        Range of a feature in normal windows; by default the median of these windows is usual, and
        all else is outside.
    """
    where, normal = json.loads(tables.run[WHERE].iloc[0]), normal or {}
    firsts: dict[tuple[str, bool], Deviation] = {}
    for each in deviations:
        signal = topic_of_signal(each.feature) and each.feature.rpartition(".")[0]
        firsts.setdefault((signal or each.feature, each.feature in tables.windows), each)
    return tuple(
        Evidence(
            each.feature, each.z, each.capped, each.value, each.unit, each.usual_low,
            each.usual_high, where.get(each.feature) or topic_of_signal(each.feature) or None,
            *_span(each, tables.windows, normal.get(each.feature)),
        )
        for each in [*firsts.values()][:SHOWN]
    )  # fmt: skip


def window_series(
    evidence: Sequence[Evidence], windows: pd.DataFrame, normal: Mapping[str, NormalRange]
) -> tuple[WindowSeries, ...]:
    """Return the values in windows of the features that windows have.

    Parameters
    ----------
    evidence : sequence of Evidence
    windows : DataFrame
        Of the recording, one row each.
    normal : mapping of str to NormalRange
        Range of a feature in normal windows, where the reference has it.
    """
    starts = tuple(windows[WINDOW_START].tolist())
    found = []
    for each in evidence:
        values = [v if math.isfinite(v) else None for v in windows.get(each.feature, [])]
        known = [value for value in values if value is not None]
        within = normal.get(each.feature)
        low, high = (within.low, within.high) if within else (None, None)
        if within and math.isinf(within.high):  # as far as the values reach
            low, high = min([within.usual, *known]), max([within.usual, *known])
        if known:
            found.append(WindowSeries(each.feature, each.unit, starts, tuple(values), low, high))
    return tuple(found)


def _span(
    deviation: Deviation, windows: pd.DataFrame, normal: NormalRange | None
) -> tuple[float | None, float | None]:
    """Return start and end of the change around the window that deviates most [s].

    A change lasts while windows are outside the range of normal windows, and at least half as far
    from usual as the farthest. Windows overlap by half. What the first unusual window shares with
    the usual one before it does not show the change, so the change begins in its second half.

    The start is None if no window is outside in the direction of the whole recording, or all are
    equal; the end is None if the change lasts to the end of the recording.
    """
    if deviation.feature not in windows.columns or windows[deviation.feature].nunique() < 2:
        return None, None
    values = windows[deviation.feature].to_numpy(dtype=np.float64)
    low, usual, high = normal or [float(np.nanmedian(values))] * 3
    distance = np.sign(deviation.z) * (values - usual)
    distance[(low <= values) & (values <= high)] = 0.0
    farthest = int(np.nanargmax(distance))
    if distance[farthest] <= 0.0:
        return None, None
    back = ~(distance >= _STILL_FAR * distance[farthest])  # or without a value
    before, after = np.flatnonzero(back[:farthest]), np.flatnonzero(back[farthest:])
    first = before[-1] + 1 if len(before) else 0
    last = farthest + after[0] - 1 if len(after) else len(back) - 1
    starts = windows[WINDOW_START].to_numpy(dtype=np.float64)
    begins_later = len(before) and (first < last or not len(after))
    end = float(starts[last]) + WINDOW_S if len(after) else None
    return float(starts[first]) + (HOP_S if begins_later else 0.0), end
