"""Learns reference cards from normal runs, one for each kind of system in a reference."""

import itertools
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline import datasets
from oracle_pipeline.detectors import Mahalanobis, named_detector, single_threaded
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.robots.known import Known
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring import run_scorer
from oracle_pipeline.scoring.card import ReferenceCard, is_card
from oracle_pipeline.scoring.comparable import (
    given_numbers,
    lacking_numbers,
    same_kind,
    shared_features,
)
from oracle_pipeline.scoring.conformal import ConformalError
from oracle_pipeline.scoring.contract import Contract, Observation
from oracle_pipeline.scoring.cross_conformal import SEED, CrossConformalScorer
from oracle_pipeline.scoring.feature_sets import ASPECTS, feature_sets
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.reference import Reference, read_reference
from oracle_pipeline.scoring.selection import counted, without_odd
from oracle_pipeline.scoring.starts import effects_of_start
from oracle_pipeline.scoring.verdict import CardOrigin, ScoringError

DISTRIBUTION = "ros2-behaviour-oracle"
LONG = 10  # windows of a recording; in a shorter one, signals of the whole show a short fault
FEWEST_IN_RANGE = 10  # recordings; the range of fewer says little of one signal alone
COMMON_SIGNAL = 0.8  # least share of the rows in which a signal is, to be compared
OF_SETTING = 0.2  # a signal that changes less in a recording than this, of what these differ by
FEWEST_BROKEN, COMMONLY_BROKEN = 2, 0.1  # recordings, and their share, with a term that is unsteady
WINDOWS_UNKNOWN = (
    "The reference has no features of windows, so only whole recordings are compared: a short "
    "attack in a long recording may be missed. Use a table with windows.parquet beside it."
)


def learn(reference: Reference, detector: str = "") -> ReferenceCard:
    """Learn what is normal from the normal runs of a reference.

    Copies count once, and recordings that are unlike all others are set aside (`selection`).

    Parameters
    ----------
    reference : Reference
    detector : str
        Name of a detector that scores alone; empty for ours.

    Raises
    ------
    OracleError
        There are too few normal runs, or they have no feature.
    """
    reference = counted(reference)
    try:
        card = _learned(reference, detector)
    except ConformalError as error:
        raise ConformalError(" ".join([str(error), *reference.notes])) from error
    held_out = pd.Series(card.scorer.held_out_, index=card.runs["run_id"])
    scores = held_out.loc[reference.table["run_id"]].to_numpy(dtype=np.float64)
    remaining = without_odd(reference, np.array(scores))
    return card if remaining is None else _learned(remaining, detector)


@np.errstate(all="ignore")  # features may be as large as numbers can be
def _learned(reference: Reference, detector: str) -> ReferenceCard:
    """Learn from all runs of a reference."""
    notes = []
    table, windows = reference.table, reference.windows
    if windows is None:
        notes.append(WINDOWS_UNKNOWN)
        windows = pd.DataFrame({"run_id": table["run_id"], "window_start_s": 0.0})
    runs = MeasuredRuns.ordered(table, windows)
    scorer = learned_scorer(runs, detector=detector)
    sets = {} if detector else feature_sets(runs.features)
    aspects = {name: learned_scorer(runs, name) for name in ASPECTS if name in sets}
    contract, breaching = None, None
    if reference.observations:
        observations = reference.observations
        fold_of = pd.Series(scorer.fold_, index=runs.features["run_id"])
        broken = _broken_terms(observations, table, fold_of.loc[table["run_id"]].to_numpy())
        unsteady = _unsteady(broken)
        contract = replace(Contract.learned(observations), unsteady=unsteady)
        breaching = sum(bool(terms - unsteady) for terms in broken)
    return ReferenceCard(
        scorer, runs.features, contract, (*notes, *reference.notes), aspects, reference.roles,
        breaching, CardOrigin("", version(DISTRIBUTION), datetime.now(UTC).date().isoformat()),
    )  # fmt: skip


def _broken_terms(
    observations: Sequence[Observation], table: pd.DataFrame, folds: NDArray[np.int64]
) -> list[set[str]]:
    """Return the terms that each recording breaks of the contract that the other folds teach."""
    broken: list[set[str]] = [set() for _ in observations]
    given = given_numbers(table)
    for fold in np.unique(folds):
        others = given[folds != fold]
        others = others.loc[:, others.all()].iloc[:1]  # what all of them have
        contract = Contract.learned(list(itertools.compress(observations, folds != fold)))
        for n in np.flatnonzero(folds == fold).tolist():
            lacking = lacking_numbers(given.iloc[[n]], others)
            broken[n] = contract.broken_terms(observations[n], lacking)
    return broken


def _unsteady(broken: Sequence[set[str]]) -> frozenset[str]:
    """Return the terms that several recordings break: they say little of this kind of system."""
    counts = Counter(term for terms in broken for term in terms)
    least = max(FEWEST_BROKEN, COMMONLY_BROKEN * len(broken))
    return frozenset(term for term, count in counts.items() if count >= least)


def learned_scorer(
    normal: MeasuredRuns, features: str = "all", detector: str = ""
) -> CrossConformalScorer:
    """Return a scorer that is fitted on normal runs.

    Parameters
    ----------
    normal : MeasuredRuns
    features : str
        Name of the set of features (`feature_sets`).
    detector : str
        Name of a detector that scores alone; empty for ours.

    Raises
    ------
    OracleError
        There are too few runs, or they have no feature.
    """
    scorer_design = design(normal, features)
    if detector:
        scorer_design = _of_detector(scorer_design, detector)
    with single_threaded():
        return CrossConformalScorer(scorer_design).fit(normal, np.random.default_rng(SEED))


def design(runs: MeasuredRuns, features: str = "all") -> run_scorer.Design:
    """Return the design: the features of a set that these runs and their windows have."""
    columns = feature_sets(runs.features).get(features, [])
    if not columns:
        raise ScoringError("The normal runs have no feature with a value; extract them again.")
    of_windows = set(datasets.feature_columns(runs.windows))
    of_features = run_scorer.Design(
        Mahalanobis(),
        tuple(columns),
        tuple(column for column in columns if column in of_windows),
        datasets.feature_floors(runs.features),
    )
    return _with_signals(of_features, runs) if features == "all" else of_features


def _with_signals(of_features: run_scorer.Design, runs: MeasuredRuns) -> run_scorer.Design:
    """Return a design with signals, and without features that say little beside them.

    Features of any bag measure bytes and rates. Signals tell more about a robot that has no other
    features: they have every number, and the time between messages. In a recording of one window,
    features of motion and of sensors that agree scatter, since the robot hardly moved.
    """
    settings = settings_among(runs.features)
    run_signals = common_signals(runs.features, settings)
    if not run_signals:
        return of_features
    fields = datasets.field_metadata(runs.features)
    knows_robot = any(fields[c].get("origin") != "generic" for c in of_features.run_features)
    has_moved = np.median(runs.counts) > 1
    is_long = run_scorer.common_length(runs.counts) >= LONG
    has_range = len(runs.counts) >= FEWEST_IN_RANGE
    left_out = {*(() if is_long else run_scorer.OF_WINDOWS), *(() if has_range else ("farthest",))}
    of_signals = (level for level in run_scorer.OF_SIGNALS if level not in left_out)
    window_signals = common_signals(runs.windows, settings) if is_long else ()
    return replace(
        of_features,
        floors={**of_features.floors, **effects_of_start(runs)},
        run_signals=run_signals,
        window_signals=window_signals,
        levels=(*(run_scorer.OF_FEATURES if knows_robot and has_moved else ()), *of_signals),
    )


def _of_detector(ours: run_scorer.Design, name: str) -> run_scorer.Design:
    """Return a design of one detector on plain statistics of signals, or else on features."""
    level = run_scorer.PLAIN if ours.columns(run_scorer.PLAIN) else "run"
    return replace(
        ours, detector=named_detector(name, SEED), named=name, levels=(level,), window_features=()
    )


def common_signals(table: pd.DataFrame, settings: Collection[str]) -> tuple[str, ...]:
    """Return the columns of signals that nearly all rows have, and that can tell something.

    Those are not the levels of settings, nor differences from commands that nothing follows.
    """
    columns = datasets.signal_columns(table)
    given = np.isfinite(table[columns].to_numpy(dtype=np.float64)).mean(axis=0)
    return tuple(
        column
        for column, share in zip(columns, given, strict=True)
        if share >= COMMON_SIGNAL
        and not _is_level_of(settings, column)
        and not (datasets.MINUS in column and _follows_nothing(table, column))
    )


def settings_among(runs: pd.DataFrame) -> set[str]:
    """Return the signals that hardly change within recordings, beside how these differ.

    They are settings, or the world, such as the size of the map. Their level says where a robot is,
    not what it does: in a world that was never seen, it would be far from usual. Times between
    messages are none: a rate is behaviour. What is 0 in all runs is none: it may be an error.
    """
    found = set()
    for column in datasets.signal_columns(runs):
        signal, _, statistic = column.rpartition(".")
        spread = f"{signal}.std"
        is_time = signal.endswith("/period") or datasets.is_lag(signal)
        if statistic == "mean" and spread in runs and not is_time:
            within, between = np.median(np.nan_to_num(runs[spread])), runs[column].std(ddof=0)
            if within <= OF_SETTING * between and np.nan_to_num(runs[column]).any():
                found.add(signal)
    return found


def _follows_nothing(table: pd.DataFrame, difference: str) -> bool:
    """Return whether a difference varies at least as much as the number it is taken from."""
    signal, number = difference.rpartition(".")[0], difference.partition(datasets.MINUS)[0]
    error = signal.removesuffix(datasets.LAG) if datasets.is_lag(signal) else signal
    spreads = [f"{name}.std" for name in (error, number)]
    if not all(spread in table for spread in spreads):  # a field of a table may have such a name
        return False
    of_error, of_number = (np.median(np.nan_to_num(table[spread])) for spread in spreads)
    return bool(of_error >= of_number)


def _is_level_of(settings: Collection[str], column: str) -> bool:
    signal, _, statistic = column.rpartition(".")
    return statistic in ("mean", "min", "max") and signal in settings


def card_source(
    path: Path, manager: FeatureManager, choices: RoleChoices | None = None, detector: str = ""
) -> "ReferenceCard | Cards":
    """Return a card from its file, or cards that are learned from normal runs at a path.

    Raises
    ------
    OracleError
        There is neither, or the card is that of another detector than the one named.
    """
    if is_card(path):
        return ReferenceCard.load(path).by_detector(detector)
    return Cards(read_reference([path], manager, choices), detector)


class Cards:
    """A card for each kind of system in a reference, learned when it is first needed.

    One table may have runs of a robot and of an air traffic system. Runs are of the same kind as a
    recording if they have values in the same families of features.

    Parameters
    ----------
    reference : Reference
    detector : str
        As for `learn`.
    """

    def __init__(self, reference: Reference, detector: str = "") -> None:
        self._reference = reference
        self._detector = detector
        self._cards: dict[frozenset[str], ReferenceCard] = {}

    @property
    def origin(self) -> CardOrigin | None:
        """None: these cards are in no file."""
        return None

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the cards used so far, for readers of the verdicts."""
        return tuple(dict.fromkeys(note for card in self._cards.values() for note in card.notes))

    @property
    def roles(self) -> RoleChoices | None:
        """Robots and topics from the roles file of the recordings; None without one."""
        return self._reference.roles

    @property
    def known(self) -> Known | None:
        """Topics of the normal recordings, and their roles; None if only tables were read."""
        normal = ~datasets.is_malicious(self._reference.table)
        seen = list(itertools.compress(self._reference.observations, normal))
        return Contract.learned(seen).known if seen else None

    def card_for(self, row: pd.DataFrame) -> ReferenceCard:
        """Return the card for the kind of system that a recording comes from."""
        table = self._reference.table
        columns, _ = shared_features(row, table, feature_sets(table).get("all", []))
        kind = frozenset(column.split(".", 1)[0] for column in columns)
        if kind not in self._cards:
            self._cards[kind] = learn(self._of_kind(columns), self._detector)
        return self._cards[kind]

    def _of_kind(self, columns: Sequence[str]) -> Reference:
        reference = self._reference
        alike = same_kind(reference.table, columns) | datasets.is_malicious(reference.table)
        notes = reference.notes
        if not alike.all():
            notes = (
                f"{np.sum(~alike)} normal runs of the reference are left out, because they come "
                "from another kind of system: they lack a whole family of features that this "
                "recording has.",
                *notes,
            )
        observations = tuple(itertools.compress(reference.observations, alike))
        return Reference(
            reference.table[alike], reference.windows, observations, notes, reference.roles
        )
