"""Metamorphic and differential oracle: compares a run with other runs of the same task.

The correct path is unknown, but the same task in the same world should give about the same outcome,
whichever build drives. The runs of a block have equal start, goals and world: each is compared with
the unaltered runs of its block. How far these are from each other is the unit.

The same holds for a task in a known relation to it, such as the mirrored one: where the robot
turned left, it should turn right. Where there are such follow-up runs, a run is compared with them.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.features.plugin import hookimpl
from oracle_pipeline.oracles.kind import RELATION, SAME, KindError, Maker, Material, TracedRuns
from oracle_pipeline.oracles.traces import SIGNALS, STEP_S, values_of

PERCENTILES = (5.0, 50.0, 95.0)
FEWEST = 20  # comparisons of normal runs that tell a spread
OTHER_WAY = ("mirrored", "reordered")  # relations in which left is right
TURNS = ("command_turn", "turn", "gyro_turn")  # signals that are positive to the left

_NAMES = tuple(SIGNALS)
_TURNING = [_NAMES.index(name) for name in TURNS]


def outcomes(trace: pd.DataFrame) -> NDArray[np.float64]:
    """Return the outcome of a run: percentiles of all signals, path length, turning and time.

    Returns
    -------
    ndarray of shape (3 * n_signals + 3,)
        NaN where the trace lacks a signal. The way by odometry [m], how far it turned [rad], and
        how long a goal was under way [s].
    """
    values = values_of(trace, _NAMES)
    levels = np.full((len(PERCENTILES), len(_NAMES)), np.nan)
    known = np.isfinite(values).any(axis=0)
    if known.any():
        levels[:, known] = np.nanpercentile(values[:, known], PERCENTILES, axis=0)
    way = trace["travelled"].max()
    turned = np.nansum(np.abs(trace["turn"])) * STEP_S
    under_way_s = float((trace["goal_time"] > 0.0).sum()) * STEP_S
    return np.array([*levels.ravel(), way, turned, under_way_s], dtype=np.float64)


def in_its_place(outcome: NDArray[np.float64], relation: str) -> NDArray[np.float64]:
    """Return what the outcome of a follow-up run says of the task that it was derived from."""
    if relation not in OTHER_WAY:
        return outcome
    seen = outcome.copy()
    levels = seen[: len(PERCENTILES) * len(_NAMES)].reshape(len(PERCENTILES), -1)  # a view
    levels[:, _TURNING] = 0.0 - levels[::-1, _TURNING]
    return seen


_FLOORS = np.array([*[SIGNALS[name].floor for name in _NAMES] * len(PERCENTILES), 0.1, 0.2, 0.5])


@dataclass(frozen=True, eq=False, slots=True)
class _Judge:
    kind: "Metamorphic"
    spread: NDArray[np.float64]

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run's largest difference from the runs of its task, in spreads."""
        apart = np.abs(self.kind.differences(runs)) / self.spread
        return np.asarray(np.nan_to_num(apart).max(axis=1), dtype=np.float64)


class Metamorphic:
    """Compares runs with the unaltered runs of their task, and of tasks in a relation to it.

    Parameters
    ----------
    partners : TracedRuns
        All runs that may serve as the other side of a comparison; only normal ones in which nothing
        was changed do.
    follow_ups : TracedRuns, optional
        Runs of the same blocks in another relation, by the column ``relation``; as for partners.
    """

    name = "metamorphic"
    asks = "a second run of each task"

    def __init__(self, partners: TracedRuns, follow_ups: TracedRuns | None = None) -> None:
        self._partners = {SAME: _unaltered(partners)}
        if follow_ups is not None:
            relations = follow_ups.table[RELATION].to_numpy(dtype=str)
            for name in sorted(set(relations)):
                self._partners[name] = _unaltered(follow_ups.where(relations == name))
        self._differences: dict[int, tuple[pd.DataFrame, NDArray[np.float64]]] = {}  # by trace

    def learn(self, normal: TracedRuns) -> _Judge:
        """Learn how far normal runs of one task are from each other, in each relation.

        Raises
        ------
        KindError
            Too few can be compared. Or some have no follow-up run: they would pass as if they had
            agreed with it, so p-values of those that have one would be too small.
        """
        apart = self.differences(normal).reshape(len(normal.traces), len(self._partners), -1)
        compared = np.isfinite(apart).any(axis=2).sum(axis=0)
        if compared.max() < FEWEST:
            raise KindError(
                f"{compared.max()} normal runs have another run of the same task, {FEWEST} are "
                "needed; record several runs of each block, or the blocks with --relation mirrored."
            )
        for name, number in zip(self._partners, compared, strict=True):
            if name != SAME and number < len(normal.traces):
                raise KindError(
                    f"{len(normal.traces) - number} of {len(normal.traces)} normal runs have no "
                    f"{name} run of their block; record it for all blocks, or leave it out."
                )
        spread = np.full(apart.shape[1:], np.inf)
        for relation in np.flatnonzero(compared >= FEWEST):
            known = np.isfinite(apart[:, relation]).any(axis=0)
            far = np.nanmedian(np.abs(apart[:, relation, known]), axis=0)
            spread[relation] = _FLOORS
            spread[relation, known] = np.maximum(MAD_TO_DEVIATION * far, _FLOORS[known])
        return _Judge(self, spread.ravel())

    def differences(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run less the median of its partners in each relation.

        An exact repetition says nothing, so equal partners count once, and a run is no partner of
        itself.

        Returns
        -------
        ndarray of shape (n_runs, n_relations * n_outcomes)
            NaN where there is no partner.
        """
        known = self._differences
        for trace, own, block in zip(runs.traces, runs.each(outcomes), runs.block, strict=True):
            if id(trace) not in known:  # the trace is kept, so its identity stays its own
                known[id(trace)] = trace, self._difference(own, int(block))
        return np.stack([known[id(trace)][1] for trace in runs.traces])

    def _difference(self, own: NDArray[np.float64], block: int) -> NDArray[np.float64]:
        differences = np.full((len(self._partners), len(own)), np.nan)
        for row, (relation, partners) in zip(differences, self._partners.items(), strict=True):
            here = partners.where(partners.block == block)
            if not here.traces:
                continue
            others = np.unique(here.each(outcomes), axis=0)
            others = np.array([in_its_place(other, relation) for other in others])
            others = others[~np.isclose(others, own, equal_nan=True).all(axis=1)]
            if len(others):
                known = np.isfinite(others).any(axis=0)
                row[known] = own[known] - np.nanmedian(others[:, known], axis=0)
        return differences.ravel()

    def written(self) -> int:
        """Return how many recordings serve as partners."""
        return sum(len(partners.traces) for partners in self._partners.values())


def _unaltered(runs: TracedRuns) -> TracedRuns:
    return runs.where(runs.normal & ~is_hard_negative(runs.table))


def _made(material: Material) -> Metamorphic | None:
    """Return the kind if some task was run twice, or in another relation."""
    plain = material.runs.block[material.runs.normal]
    if material.follow_ups is None and len(np.unique(plain)) == len(plain):
        return None
    return Metamorphic(material.runs, material.follow_ups)


@hookimpl
def register_oracles() -> list[Maker]:
    """Offer the oracle that compares runs of one task."""
    return [_made]
