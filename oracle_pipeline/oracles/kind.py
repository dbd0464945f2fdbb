"""The interface of a kind of oracle: it maps a run to one number; higher is worse.

``calibration`` turns the number into a p-value in the same way for all kinds, and ``registry``
finds the kinds.
"""

import hashlib
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import LABELS
from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.oracles.requirements import Requirements
from oracle_pipeline.oracles.traces import SIGNALS, TIME

RELATION = "relation"  # column: relation of a run to the runs of its block, from its recipe
SAME = "same"  # the relation of all runs that are judged

# Cache by function and identity of a trace: the trace, and the result of the function for it.
_Cache: TypeAlias = dict[Hashable, dict[int, tuple[pd.DataFrame, NDArray[np.float64]]]]


class KindError(OracleError):
    """A kind of oracle cannot be used."""


@dataclass(frozen=True, eq=False, slots=True)
class TracedRuns:
    """Runs and their traces, in the same order.

    Attributes
    ----------
    table : DataFrame
        One row for each run: the keys and perhaps features.
    traces : tuple of DataFrame
        From `traces.read_trace`, one for each run.
    """

    table: pd.DataFrame
    traces: tuple[pd.DataFrame, ...]
    _cache: _Cache = field(default_factory=dict, repr=False)  # shared with results of `where`

    def where(self, chosen: NDArray[np.bool_]) -> "TracedRuns":
        """Return the runs of a mask of shape (n_runs,)."""
        kept = tuple(self.traces[row] for row in np.flatnonzero(chosen))
        return TracedRuns(self.table[chosen].reset_index(drop=True), kept, self._cache)

    def each(self, compute: Callable[[pd.DataFrame], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the stacked results of a function for each trace.

        Results are cached for all kinds and folds; equal functions share a cache.
        """
        cache = self._cache.setdefault(compute, {})
        for trace in self.traces:
            if id(trace) not in cache:  # the cache keeps the trace alive, so its id stays unique
                cache[id(trace)] = trace, compute(trace)
        return np.stack([cache[id(trace)][1] for trace in self.traces])

    def digests(self) -> list[str]:
        """Return a hash of each trace, by which a recording is known under any name."""
        return [_digest(trace) for trace in self.traces]

    def known_in(self, digests: Collection[str]) -> NDArray[np.bool_]:
        """Return a mask of the runs with one of the digests, with further signals or without."""
        own = [{_digest(trace), _digest(trace[[TIME, *SIGNALS]])} for trace in self.traces]
        return np.array([not each.isdisjoint(digests) for each in own], dtype=np.bool_)

    @property
    def block(self) -> NDArray[np.int64]:
        """Block of each run, shape (n_runs,)."""
        return self.table["block"].to_numpy(dtype=np.int64)

    @property
    def session(self) -> NDArray[np.int64]:
        """Session of each run, shape (n_runs,)."""
        return self.table["session"].to_numpy(dtype=np.int64)

    @property
    def malicious(self) -> NDArray[np.bool_]:
        """Which runs were attacked, shape (n_runs,)."""
        return is_malicious(self.table)

    @property
    def normal(self) -> NDArray[np.bool_]:
        """Mask of the runs that are known to be normal, shape (n_runs,)."""
        return np.asarray(self.table["label"].isin(LABELS), dtype=np.bool_) & ~self.malicious


def _digest(trace: pd.DataFrame) -> str:
    return hashlib.sha256(trace.to_numpy().tobytes()).hexdigest()[:16]


class FittedOracle(Protocol):
    """A fitted oracle, which maps runs to numbers."""

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return the score of each run, shape (n_runs,); finite, higher is worse."""


class OracleKind(Protocol):
    """One kind of oracle.

    Attributes
    ----------
    name : str
        One word.
    asks : str
        Input that people must give, in a few words.
    """

    name: str
    asks: str

    def learn(self, normal: TracedRuns) -> FittedOracle:
        """Return the oracle that is fitted on normal runs; a kind may be its own."""


@dataclass(frozen=True, slots=True)
class Material:
    """The inputs from which a kind is built.

    Attributes
    ----------
    runs : TracedRuns
        All runs that are compared.
    requirements : Requirements
        Formulas that runs should satisfy.
    answers : mapping of str to bool
        Answers of people, by run; True means bad.
    follow_ups : TracedRuns or None
        Runs of the same blocks in another relation than `SAME`, with a column `RELATION`. They are
        not judged.
    """

    runs: TracedRuns
    requirements: Requirements
    answers: Mapping[str, bool] = field(default_factory=dict)
    follow_ups: TracedRuns | None = None

    def not_learned_from(self) -> tuple["Material", str]:
        """Return the material without runs that the formulas were learned from, and a note.

        No such run breaks a formula, so all normal runs would seem to keep them. If there is no
        other normal run, the formulas are left out instead.
        """
        known = self.runs.known_in(self.requirements.learned_from)
        if not known.any():
            return self, ""
        if not (self.runs.normal & ~known).any():
            return replace(self, requirements=Requirements()), (
                f"The requirements are left out: they were learned from all {known.sum()} normal "
                "recordings. Give other normal recordings, too."
            )
        return replace(self, runs=self.runs.where(~known)), (
            f"{known.sum()} recordings are left out: the requirements were learned from them."
        )


Maker = Callable[[Material], OracleKind | None]
