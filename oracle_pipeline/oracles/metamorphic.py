"""Metamorphic and differential oracle: compares a run with other runs of the same task.

The correct path is unknown, but the same task in the same world should give about the same outcome
with any build. The runs of a block have equal start, goals and world: each is compared with the
unaltered runs of its block, in units of their spread.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.features.plugin import hookimpl
from oracle_pipeline.oracles.kind import KindError, Maker, Material, TracedRuns
from oracle_pipeline.oracles.traces import SIGNALS, STEP_S, values_of

PERCENTILES = (5.0, 50.0, 95.0)
FEWEST = 20  # comparisons of normal runs needed to estimate the spread

_NAMES = tuple(SIGNALS)


def outcomes(trace: pd.DataFrame) -> NDArray[np.float64]:
    """Return the outcome of a run: percentiles of all signals, path length, turning and time.

    Returns
    -------
    ndarray of shape (3 * n_signals + 3,)
        NaN where the trace lacks a signal. The last three are path length by odometry [m], total
        turning [rad], and time with an active goal [s].
    """
    values = values_of(trace, _NAMES)
    levels = np.full((len(PERCENTILES), len(_NAMES)), np.nan)
    known = np.isfinite(values).any(axis=0)
    if known.any():
        levels[:, known] = np.nanpercentile(values[:, known], PERCENTILES, axis=0)
    path_m = trace["travelled"].max()
    turned = np.nansum(np.abs(trace["turn"])) * STEP_S
    active_s = float((trace["goal_time"] > 0.0).sum()) * STEP_S
    return np.array([*levels.ravel(), path_m, turned, active_s], dtype=np.float64)


_FLOORS = np.array([*[SIGNALS[name].floor for name in _NAMES] * len(PERCENTILES), 0.1, 0.2, 0.5])


@dataclass(frozen=True, eq=False, slots=True)
class _Judge:
    kind: "Metamorphic"
    spread: NDArray[np.float64]

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run's largest difference from the runs of its task, in spreads."""
        difference = np.abs(self.kind.differences(runs)) / self.spread
        return np.asarray(np.nan_to_num(difference).max(axis=1), dtype=np.float64)


class Metamorphic:
    """Compares runs with the unaltered runs of their task.

    Parameters
    ----------
    partners : TracedRuns
        Candidates to compare with; only unaltered normal runs are used.
    """

    name = "metamorphic"
    asks = "a second run of each task"

    def __init__(self, partners: TracedRuns) -> None:
        plain = partners.normal & ~is_hard_negative(partners.table)
        self._partners = partners.where(plain)
        self._differences: dict[int, tuple[pd.DataFrame, NDArray[np.float64]]] = {}  # by trace

    def learn(self, normal: TracedRuns) -> _Judge:
        """Learn the spread of normal runs of the same task."""
        differences = self.differences(normal)
        compared = int(np.isfinite(differences).any(axis=1).sum())
        if compared < FEWEST:
            raise KindError(
                f"{compared} normal runs have another run of the same task, but {FEWEST} are "
                "needed; record several runs of each block."
            )
        known = np.isfinite(differences).any(axis=0)
        spread = np.zeros(differences.shape[1])
        spread[known] = MAD_TO_DEVIATION * np.nanmedian(np.abs(differences[:, known]), axis=0)
        return _Judge(self, np.maximum(spread, _FLOORS))

    def differences(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run minus the median of its partners, shape (n_runs, n_outcomes).

        Exact repetitions carry no information, so equal partners count once, and a run is never its
        own partner. NaN without partners.
        """
        known = self._differences
        for trace, own, block in zip(runs.traces, runs.each(outcomes), runs.block, strict=True):
            if id(trace) not in known:  # the cache keeps the trace alive, so its id stays unique
                known[id(trace)] = trace, self._difference(own, int(block))
        return np.stack([known[id(trace)][1] for trace in runs.traces])

    def _difference(self, own: NDArray[np.float64], block: int) -> NDArray[np.float64]:
        others = self._partners.each(outcomes)[self._partners.block == block]
        others = np.unique(others, axis=0)
        others = others[~np.isclose(others, own, equal_nan=True).all(axis=1)]
        difference = np.full(len(own), np.nan)
        if len(others):
            known = np.isfinite(others).any(axis=0)
            difference[known] = own[known] - np.nanmedian(others[:, known], axis=0)
        return difference

    def written(self) -> int:
        """Return the number of recordings that serve as partners."""
        return len(self._partners.traces)


def _make(material: Material) -> Metamorphic | None:
    """Return the kind if any task was run twice."""
    plain = material.runs.block[material.runs.normal]
    return Metamorphic(material.runs) if len(np.unique(plain)) < len(plain) else None


@hookimpl
def register_oracles() -> list[Maker]:
    """Register the oracle that compares runs of the same task."""
    return [_make]
