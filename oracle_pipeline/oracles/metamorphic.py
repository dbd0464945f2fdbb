"""Differential and metamorphic oracles: compare a run with other runs of its task or a related one.

The correct path is unknown, but the same task in the same world should give about the same outcome
with any build, settings or seed. The runs of a block have equal start, goals and world: the
differential oracle compares each with the unaltered runs of its block, in units of their spread.

The metamorphic oracle compares it with runs of related tasks. In the mirrored world, for example,
the robot should turn right where it turned left.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.features.engine.plugin import hookimpl
from oracle_pipeline.oracles.kind import RELATION, SAME, KindError, Maker, Material, TracedRuns
from oracle_pipeline.oracles.traces import SIGNALS, STEP_S, values_of

_PERCENTILES = (5.0, 50.0, 95.0)
_FEWEST = 12  # comparisons of normal runs to estimate the spread; with 20, no more is found
_SWAPPED = ("mirrored", "reordered")  # relations in which left and right turns are swapped
_TURNS = ("command_turn", "turn", "gyro_turn")  # signals that are positive to the left

_NAMES = tuple(SIGNALS)
_TURNING = [_NAMES.index(name) for name in _TURNS]


def _outcomes(trace: pd.DataFrame) -> NDArray[np.float64]:
    """Return the outcome of a run: percentiles of all signals, path length, turning and time.

    Returns
    -------
    ndarray of shape (3 * n_signals + 3,)
        NaN where the trace lacks a signal. The last three are path length by odometry [m], total
        turning [rad], and time with an active goal [s].
    """
    values = values_of(trace, _NAMES)
    levels = np.full((len(_PERCENTILES), len(_NAMES)), np.nan)
    known = np.isfinite(values).any(axis=0)
    if known.any():
        levels[:, known] = np.nanpercentile(values[:, known], _PERCENTILES, axis=0)
    path_m = trace["travelled"].max()
    turned = np.nansum(np.abs(trace["turn"])) * STEP_S
    active_s = float((trace["goal_time"] > 0.0).sum()) * STEP_S
    return np.array([*levels.ravel(), path_m, turned, active_s], dtype=np.float64)


def _as_original(outcome: NDArray[np.float64], relation: str) -> NDArray[np.float64]:
    """Return the outcome that a follow-up run predicts for the original task."""
    if relation not in _SWAPPED:
        return outcome
    seen = outcome.copy()
    levels = seen[: len(_PERCENTILES) * len(_NAMES)].reshape(len(_PERCENTILES), -1)  # a view
    levels[:, _TURNING] = 0.0 - levels[::-1, _TURNING]
    return seen


_FLOORS = np.array([*[SIGNALS[name].floor for name in _NAMES] * len(_PERCENTILES), 0.1, 0.2, 0.5])


@dataclass(frozen=True, eq=False, slots=True)
class _Judge:
    kind: "_Comparing"
    spread: NDArray[np.float64]

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run's largest difference from the runs of its task, in spreads."""
        difference = np.abs(self.kind.differences(runs)) / self.spread
        return np.asarray(np.nan_to_num(difference).max(axis=1), dtype=np.float64)


class _Comparing:
    """Compares runs with unaltered normal ones of their block, in each of some relations."""

    missing: str  # what too few normal runs have, and what to do

    def __init__(self, partners: Mapping[str, TracedRuns]) -> None:
        self._partners = {name: _unaltered(runs) for name, runs in partners.items()}
        self._differences: dict[int, tuple[pd.DataFrame, NDArray[np.float64]]] = {}  # by trace

    def learn(self, normal: TracedRuns) -> _Judge:
        """Learn how far normal runs are apart, for each relation.

        Raises
        ------
        KindError
            Too few runs can be compared, or some have no follow-up run. Runs without one would
            count as agreeing with it, which makes the p-values of the others too small.
        """
        differences = self.differences(normal).reshape(len(normal.traces), len(self._partners), -1)
        compared = np.isfinite(differences).any(axis=2).sum(axis=0)
        if compared.max() < _FEWEST:
            raise KindError(
                self.missing.format(f"{compared.max()} normal runs have", f"{_FEWEST} are needed")
            )
        for name, number in zip(self._partners, compared, strict=True):
            if name != SAME and number < len(normal.traces):
                raise KindError(
                    f"{len(normal.traces) - number} of {len(normal.traces)} normal runs have no "
                    f"{name} run of their block; record it for all blocks, or leave it out."
                )
        spread = np.full(differences.shape[1:], np.inf)
        for relation in np.flatnonzero(compared >= _FEWEST):
            known = np.isfinite(differences[:, relation]).any(axis=0)
            typical = np.nanmedian(np.abs(differences[:, relation, known]), axis=0)
            spread[relation] = _FLOORS
            spread[relation, known] = np.maximum(MAD_TO_DEVIATION * typical, _FLOORS[known])
        return _Judge(self, spread.ravel())

    def differences(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run minus the median of its partners in each relation.

        Exact repetitions carry no information, so equal partners count once, and a run is never its
        own partner.

        Returns
        -------
        ndarray of shape (n_runs, n_relations * n_outcomes)
            NaN without partners.
        """
        known = self._differences
        for trace, own, block in zip(runs.traces, runs.each(_outcomes), runs.block, strict=True):
            if id(trace) not in known:  # the cache keeps the trace alive, so its id stays unique
                known[id(trace)] = trace, self._difference(own, int(block))
        return np.stack([known[id(trace)][1] for trace in runs.traces])

    def _difference(self, own: NDArray[np.float64], block: int) -> NDArray[np.float64]:
        differences = np.full((len(self._partners), len(own)), np.nan)
        for row, (relation, partners) in zip(differences, self._partners.items(), strict=True):
            same_task = partners.where(partners.block == block)
            if not same_task.traces:
                continue
            others = np.unique(same_task.each(_outcomes), axis=0)
            others = np.array([_as_original(other, relation) for other in others])
            others = others[~np.isclose(others, own, equal_nan=True).all(axis=1)]
            if len(others):
                known = np.isfinite(others).any(axis=0)
                row[known] = own[known] - np.nanmedian(others[:, known], axis=0)
        return differences.ravel()


class Differential(_Comparing):
    """Compares runs with the unaltered runs of their task: other builds, settings or seeds.

    Parameters
    ----------
    runs : TracedRuns
        Candidates to compare with; only unaltered normal runs are used.
    """

    name = "differential"
    asks = "a second run of each task"
    missing = "{} another run of the same task, {}; record several runs of each block."

    def __init__(self, runs: TracedRuns) -> None:
        super().__init__({SAME: runs})


class Metamorphic(_Comparing):
    """Compares runs with the unaltered runs of tasks in a relation to theirs.

    Parameters
    ----------
    follow_ups : TracedRuns
        Runs of the same blocks, each in the relation of the column ``relation``.
    """

    name = "metamorphic"
    asks = "each task in another relation"
    missing = "{} a run in another relation, {}; record the blocks with --relation mirrored."

    def __init__(self, follow_ups: TracedRuns) -> None:
        relations = follow_ups.table[RELATION].to_numpy(dtype=str)
        super().__init__(
            {name: follow_ups.where(relations == name) for name in sorted(set(relations))}
        )


def _unaltered(runs: TracedRuns) -> TracedRuns:
    return runs.where(runs.normal & ~is_hard_negative(runs.table))


def _differential(material: Material) -> Differential | None:
    """Return the kind if any task was run twice."""
    plain = material.runs.block[material.runs.normal]
    return Differential(material.runs) if len(np.unique(plain)) < len(plain) else None


def _metamorphic(material: Material) -> Metamorphic | None:
    """Return the kind if there are runs in another relation."""
    return None if material.follow_ups is None else Metamorphic(material.follow_ups)


@hookimpl
def register_oracles() -> list[Maker]:
    """Register the oracles that compare runs."""
    return [_differential, _metamorphic]
