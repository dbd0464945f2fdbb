"""The oracle that a search is against: a reference card, requirements, or a kind of oracle.

A search knows only the interface `SearchOracle`. Workers receive names and paths, and each loads
what it needs once.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from assets.search.attack_space import SearchError
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.detectors.explain import UsualRanges
from oracle_pipeline.oracles.collecting import traced_run, traced_runs
from oracle_pipeline.oracles.invariants import half_to_learn
from oracle_pipeline.oracles.kind import FittedOracle, KindError, Material, TracedRuns
from oracle_pipeline.oracles.registry import build_kinds
from oracle_pipeline.oracles.requirements import NAV2, load
from oracle_pipeline.oracles.specified import Specified
from oracle_pipeline.scoring.card import ReferenceCard, checked_card
from oracle_pipeline.scoring.comparable import shared_features
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.isolation import Reading, extracted
from oracle_pipeline.scoring.judging import judge
from oracle_pipeline.scoring.verdict import Verdict

FEATURES = "features"  # what its p-value says against a recording
_APART = 1_000_000  # added to blocks of other recordings: the same number is not the same task


@dataclass(frozen=True, slots=True)
class Judgement:
    """What an oracle says of a run.

    Attributes
    ----------
    score, p_value : float
        The score is an objective of the search; higher is worse.
    held : frozenset of str
        All that the oracle holds against the run.
    families : tuple of str
        Families of features outside their usual range, the farthest first.
    features : mapping of str to float
        Of the run, scaled as those of normal runs; empty for an oracle without features.
    """

    score: float
    p_value: float
    held: frozenset[str]
    families: tuple[str, ...] = ()
    features: Mapping[str, float] = field(default_factory=dict)


class SearchOracle(Protocol):
    """An oracle that a search is against; it can be pickled and hashed."""

    def judge(self, run: RunDirectory) -> Judgement:
        """Judge one run."""

    def __hash__(self) -> int:
        """Return the hash by which judgements are cached."""


def find_oracle(named: str, normal: Path | None, far: float, controls: Path) -> SearchOracle:
    """Return the oracle of a name.

    Parameters
    ----------
    named : str
        A file of requirements (``.yaml``), a reference card, or a kind of oracle.
    normal : Path, optional
        Folder of normal recordings, for all but a card.
    far : float
        False positive rate at which it decides.
    controls : Path
        Folder of the search's runs without an attack.
    """
    file = Path(named)
    if not file.is_file():
        return KindOracle(named, None, normal, far, controls)
    if file.suffix in (".yaml", ".yml"):
        load(file)  # a fault is an error before anything runs
        return KindOracle(Specified.name, file, normal, far, controls)
    return CardOracle(file, far)


@dataclass(frozen=True, slots=True)
class CardOracle:
    """The whole verdict of a reference card, as from ``oracle score``."""

    card: Path
    far: float

    def judge(self, run: RunDirectory) -> Judgement:
        """Judge one run."""
        known, ranges = _card(self.card), _ranges(self.card)
        (ours,) = extracted(run.path, reading=Reading(known=known.known))
        verdict = judge(run.key, ours.tables, known, self.far, ours.observation)
        if verdict.p_value is None or verdict.score is None:  # `judge` gives both, or raises
            raise TypeError(verdict)
        return Judgement(
            verdict.score,
            verdict.p_value,
            frozenset(against(verdict, self.far)),
            tuple(each.family for each in verdict.families if each.unusual),
            dict(zip(ranges.scaler.kept_, _scaled(ours.tables.run, ranges).tolist(), strict=True)),
        )


def against(verdict: Verdict, far: float) -> set[str]:
    """Return all that a verdict holds against a recording."""
    held = {f"contract: {line}" for line in verdict.contract}
    held |= {name for name, aspect in verdict.aspects.items() if aspect.p_value <= far}
    if verdict.alarms:
        held.add("alarms")
    if verdict.p_value is None or verdict.p_value <= far:
        held.add(FEATURES)
    return held


@dataclass(frozen=True, slots=True)
class KindOracle:
    """A kind of oracle as `oracle kinds` has it, plug-ins too.

    It learns from half of the sessions of the normal recordings; the others set its limit. A kind
    that learns nothing has all of them for its limit; without any, the limit is 0, which is where
    a requirement breaks.
    """

    name: str
    requirements: Path | None
    normal: Path | None
    far: float
    controls: Path

    def judge(self, run: RunDirectory) -> Judgement:
        """Judge one run; the score is how far it is beyond the limit.

        Raises
        ------
        SearchError
            There is no such kind, or there are too few normal recordings.
        """
        ready = _ready(self)
        score = float(ready.fitted.score(traced_run(run, ready.numbers))[0])
        p_value = (1 + np.count_nonzero(ready.usual >= score)) / (1 + len(ready.usual))
        beyond = score - ready.limit
        return Judgement(beyond, p_value, frozenset({FEATURES} if beyond > 0.0 else ()))


class _Ready(NamedTuple):
    """A fitted kind, its scores of normal runs that it did not learn from, and its limit."""

    numbers: Mapping[str, str]  # further signals of its requirements
    fitted: FittedOracle
    usual: NDArray[np.float64]
    limit: float


@functools.cache
def _ready(oracle: KindOracle) -> _Ready:
    """Fit a kind; the runs without an attack are those of the same task."""
    requirements = load(oracle.requirements or NAV2)
    numbers = requirements.signals
    controls = traced_runs([oracle.controls], [], numbers)
    normal = controls.where(np.zeros(len(controls.traces), dtype=np.bool_))
    if oracle.normal:
        normal = traced_runs([], [oracle.normal], numbers)
    normal = _apart(normal.where(normal.normal))
    both = TracedRuns(pd.concat([normal.table, controls.table]), normal.traces + controls.traces)
    material = Material(both, requirements)
    kinds = {kind.name: kind for kind in build_kinds(material)}
    if oracle.name not in kinds:
        raise SearchError(
            f"there is no oracle {oracle.name!r}; give a card, a file of requirements (.yaml), or "
            f"one of {', '.join(kinds)}."
        )
    kind = kinds[oracle.name]
    normal = normal.where(~normal.known_in(requirements.learned_from))
    seen = half_to_learn(normal)
    try:
        fitted = kind.learn(normal.where(seen))
    except KindError as error:
        raise SearchError(f"{error} Name the folder of normal recordings with --normal.") from error
    usual = normal if id(fitted) == id(kind) else normal.where(~seen)
    if oracle.normal is None:
        return _Ready(numbers, fitted, np.zeros(0), 0.0)
    needed = runs_needed(oracle.far)
    if len(usual.traces) < needed:
        raise SearchError(
            f"{len(usual.traces)} normal recordings in {oracle.normal} are left to decide at a "
            f"rate of {oracle.far:g}, {needed} are needed: record {2 * needed}, or raise --far."
        )
    scores = np.sort(fitted.score(usual))
    beyond = int(oracle.far * (1 + len(scores)) + 1e-9)  # p <= far: fewer score as high
    return _Ready(numbers, fitted, scores, float(scores[-beyond]))


def _apart(runs: TracedRuns) -> TracedRuns:
    """Return runs whose blocks and sessions are no others', as of another campaign."""
    columns = ["block", "session"]
    return TracedRuns(runs.table.assign(**(runs.table[columns] + _APART)), runs.traces)


def _scaled(row: pd.DataFrame, ranges: UsualRanges) -> NDArray[np.float64]:
    """Return the features of a run, scaled as those of the normal runs."""
    scaler = ranges.scaler
    values = row.reindex(columns=scaler.kept_).iloc[0].to_numpy(dtype=np.float64)
    return np.asarray((values - scaler.center_) / scaler.scale_, dtype=np.float64)


@functools.cache
def _ranges(card: Path) -> UsualRanges:
    known = _card(card)
    columns, _ = shared_features(known.runs, known.runs, known.scorer.design.run_features)
    return UsualRanges(known.runs, columns)


@functools.cache
def _card(path: Path) -> ReferenceCard:
    return checked_card(path)  # a worker cannot start the process in which others read a card
