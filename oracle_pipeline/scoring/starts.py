"""What a recorder that starts later does to the statistics of signals.

At the start of a recording a robot may do what it does nowhere else: its wheels stand at 0, its
place is known exactly. The statistics of a recording that lacks these seconds differ though the
robot did nothing else. So no scale is smaller than what they differ by without the first windows.
"""

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.datasets import signal_columns
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.windows import HOP_S, WINDOW_S

LATE = round(WINDOW_S / HOP_S)  # windows that a recording lacks
_PLACES = 9  # of parts to leave out, the first of them at the start
_SURE = 2.0  # standard errors that a difference is larger than
_REACH = 2.0  # standard deviations from the mean of a window to its extremes, about


def effects_of_start(runs: MeasuredRuns) -> dict[str, float]:
    """Return by how much statistics of signals differ without the first windows of recordings.

    Parameters
    ----------
    runs : MeasuredRuns
        With the statistics of signals in windows; extremes are estimated from these.

    Returns
    -------
    dict of str to float
        By column, in its unit: the root of the mean square over the runs that have more windows,
        less that without other parts, which differ by chance.
    """
    names = [c.removesuffix(".mean") for c in signal_columns(runs.windows) if c.endswith(".mean")]
    long_runs = np.flatnonzero(runs.counts > LATE)
    if not names or not len(long_runs):
        return {}
    in_windows = np.stack([
        runs.windows[[f"{name}.{statistic}" for name in names]].to_numpy(dtype=np.float64)
        for statistic in ("mean", "std", "change")
    ])  # fmt: skip
    squares = np.array([_squares(in_windows[:, runs.run == run]) for run in long_runs])
    mean, count = _mean(squares, axis=0), np.isfinite(squares).sum(axis=0)
    error = np.sqrt(_mean(np.square(squares - mean), axis=0) / np.maximum(count - 1, 1))
    effects = np.sqrt(np.maximum(mean - _SURE * error, 0.0))
    return {
        f"{name}.{statistic}": effect
        for statistic, row in zip(("mean", "std", "change", "min", "max"), effects, strict=True)
        for name, effect in zip(names, row.tolist(), strict=True)
        if np.isfinite(effect)
    }


def _squares(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return squared differences of one run without its start, less those without other parts."""
    whole, last = _over_windows(values), values.shape[1] - LATE
    starts = np.unique(np.linspace(0, last, _PLACES, dtype=np.intp))
    parts = (np.delete(values, slice(start, start + LATE), axis=1) for start in starts)
    of_start, *of_others = [np.square(_over_windows(part) - whole) for part in parts]
    return np.asarray(of_start - _mean(np.array(of_others), axis=0))


def _over_windows(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return means of mean, deviation and change, and the extremes; shape (5, n_signals)."""
    mean, deviation, _ = values
    reach = _REACH * np.nan_to_num(deviation)
    lowest, highest = np.fmin.reduce(mean - reach), np.fmax.reduce(mean + reach)
    return np.concatenate([_mean(values, axis=1), [lowest, highest]])


def _mean(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the mean of the numbers along an axis, NaN where there is none."""
    counts = np.isfinite(values).sum(axis=axis)
    return np.asarray(np.nansum(values, axis=axis) / np.where(counts, counts, np.nan))
