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
        The root mean square over the runs that have more windows, by column, in its unit.
    """
    names = [c.removesuffix(".mean") for c in signal_columns(runs.windows) if c.endswith(".mean")]
    long_runs = np.flatnonzero(runs.counts > LATE)
    if not names or not len(long_runs):
        return {}
    in_windows = np.stack([
        runs.windows[[f"{name}.{statistic}" for name in names]].to_numpy(dtype=np.float64)
        for statistic in ("mean", "std", "change")
    ])  # fmt: skip
    changes = []
    for run in long_runs:
        of_run = in_windows[:, runs.run == run]
        changes.append(_over_windows(of_run) - _over_windows(of_run[:, LATE:]))
    effects = np.sqrt(_mean(np.square(changes), axis=0))
    return {
        f"{name}.{statistic}": effect
        for statistic, row in zip(("mean", "std", "change", "min", "max"), effects, strict=True)
        for name, effect in zip(names, row.tolist(), strict=True)
        if np.isfinite(effect)
    }


def _over_windows(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return means of mean, deviation and change, and the extremes; shape (5, n_signals)."""
    mean, deviation, _ = values
    reach = _REACH * np.nan_to_num(deviation)
    lowest, highest = np.fmin.reduce(mean - reach), np.fmax.reduce(mean + reach)
    return np.concatenate([_mean(values, axis=1), [lowest, highest]])


def _mean(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the mean of the numbers along an axis, NaN where there is none."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(values, axis=axis) / np.isfinite(values).sum(axis=axis))
