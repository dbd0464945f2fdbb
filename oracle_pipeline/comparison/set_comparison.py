"""Compares two sets of recordings: which features differ, by how much, and how certainly."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.comparison import measurements as measured
from oracle_pipeline.comparison import permutation
from oracle_pipeline.datasets import SIGNALS
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.logs.formats import recordings_below
from oracle_pipeline.scoring.comparable import given_numbers, lacking_numbers
from oracle_pipeline.scoring.learning import common_signals, settings_among
from oracle_pipeline.scoring.reference import Reference, read_reference

ComparisonOutcome: TypeAlias = Literal["same", "different", "unsupported"]

SEED = 0  # of the permutations and of the intervals
RESAMPLES = 2_000  # of the intervals


class ComparisonError(OracleError):
    """Two sets of recordings cannot be compared."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One feature that differs between the sets; numbers are in its unit.

    Attributes
    ----------
    first, second : float
        Medians of the sets.
    shift, low, high : float
        Second set minus first, with its 95 % interval from resampled recordings.
    effect : float
        From -1 (all values of the second set are smaller) to 1 (all are larger).
    p_value : float
        Adjusted for all features compared.
    """

    feature: str
    unit: str
    first: float
    second: float
    shift: float
    low: float
    high: float
    effect: float
    p_value: float

    @property
    def family(self) -> str:
        """The family of the feature."""
        return measured.family_of(self.feature)


@dataclass(frozen=True, slots=True)
class SetComparison:
    """The result of comparing two sets of recordings.

    Attributes
    ----------
    outcome : str
        ``unsupported``: the sets are too small for any significant difference.
    recordings : (int, int)
        Number of recordings in each set; one with several robots counts once.
    pairs : int
        Number of compared pairs of equal mode and block; 0 if recordings have no partner.
    level : float
        Probability of at least one false difference, if the sets do not differ.
    compared : dict of str to int
        Number of varying features, by family.
    differences : tuple of Difference
        Sorted by statistic, the largest first.
    """

    outcome: ComparisonOutcome
    recordings: tuple[int, int]
    pairs: int
    level: float
    lowest_p: float
    compared: dict[str, int]
    differences: tuple[Difference, ...]
    notes: tuple[str, ...] = ()


def read_sets(first: Path, second: Path, manager: FeatureManager) -> tuple[Reference, Reference]:
    """Read two sets of recordings, as `oracle_pipeline.scoring.reference.read_reference` does.

    The set with fewer recordings comes first, so that it is refused before the features of the
    other are computed.

    Raises
    ------
    OracleError
        A set cannot be read, or has fewer than two recordings.
    """
    sets: dict[Path, Reference] = {}
    for path in sorted((first, second), key=lambda path: len(list(recordings_below(path)))):
        sets[path] = read_reference([path], manager)
        _check_size(sets[path])
    return sets[first], sets[second]


@np.errstate(all="ignore")  # features may be as large as numbers can be
def compare(first: Reference, second: Reference, level: float = 0.05) -> SetComparison:
    """Compare two sets of recordings.

    If both have the same blocks of the same modes (same start, goals and arena), each recording is
    compared with its partner; otherwise the sets are compared as a whole. Robots of one recording
    are not independent: permutations and resamples keep them together.

    Parameters
    ----------
    first, second : Reference
        From `read_sets`.
    level : float
        Probability of reporting a difference between sets that do not differ.

    Raises
    ------
    OracleError
        A set has fewer than two recordings, or no feature that varies.
    """
    for each in (first, second):
        _check_size(each)
    both = pd.concat([first.table, second.table])
    signals = common_signals(both, settings_among(both))  # a date, or a map, is no behaviour
    values = measured.aligned(*(measured.measurements(each, signals) for each in (first, second)))
    partners = _partners(first.table, second.table)
    if partners is not None:
        values = (values[0].iloc[partners[0]], values[1].iloc[partners[1]])
    resolved = measured.resolved_values(values, first.table)
    varying = measured.varying_columns(*resolved)
    if not varying.any():
        raise ComparisonError("No feature varies between these recordings; use more of them.")
    left, right = (table[:, varying] for table in resolved)
    design: permutation.PermutationDesign
    if partners is None:
        recordings = first.recordings, second.recordings
        design = permutation.TwoSamples(left, right, recordings)
    else:
        recordings = np.arange(len(left)), np.arange(len(right))
        design = permutation.MatchedPairs(left, right)
    rng = np.random.default_rng(SEED)
    columns = values[0].columns[varying].to_list()
    size = np.abs(design.t(design.real[None])[0])
    tested = zip(
        columns, size, design.effect(), permutation.adjusted_p_values(design, rng), strict=True
    )
    found = [
        Difference(
            feature=column,
            unit=measured.unit_of(column, first.table),
            **_sizes(values, recordings, column, rng, paired=partners is not None),
            effect=float(effect),
            p_value=float(p),
        )
        for column, _, effect, p in sorted(tested, key=_place)
        if p <= level
    ]
    unsupported = design.lowest_p > level
    return SetComparison(
        outcome="unsupported" if unsupported else "different" if found else "same",
        recordings=(_count(first), _count(second)),
        pairs=0 if partners is None else len(partners[0]),
        level=level,
        lowest_p=design.lowest_p,
        compared=dict(Counter(map(measured.family_of, columns))),
        differences=tuple(found),
        notes=tuple(_notes(first, second)),
    )


def _place(tested: tuple[str, float, float, float]) -> tuple[int, float]:
    """Return the place of a difference: known quantities, then signals, then bytes and rates."""
    column, size, *_ = tested
    return 2 if column.startswith("generic.") else int(column.startswith(SIGNALS)), -size


def _check_size(reference: Reference) -> None:
    if (size := _count(reference)) < 2:
        raise ComparisonError(f"A set has {size} recording; each needs at least two.")


def _count(reference: Reference) -> int:
    """Return the number of recordings."""
    return len(np.unique(reference.recordings))


def fewest(level: float, *, paired: bool) -> int:
    """Return the number of pairs, or recordings per set, that can show a difference at a level."""
    n = 2
    while 2.0 / (2**n if paired else math.comb(2 * n, n)) > level:
        n += 1
    return n


def _partners(
    first: pd.DataFrame, second: pd.DataFrame
) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Return the rows of each set sorted by block; None if the sets have different blocks.

    Modes must be the same too, unless each block occurs once in each set.
    """
    if min(first["block"].min(), second["block"].min()) < 0:  # of recordings without a manifest
        return None
    for keys in (["mode", "block"], ["block"]):
        left, right = (
            table[keys].reset_index(drop=True).sort_values(keys) for table in (first, second)
        )
        if left.duplicated().any() or len(left) != len(right):
            continue
        if np.array_equal(left.to_numpy(), right.to_numpy()):
            return left.index.to_numpy(dtype=np.intp), right.index.to_numpy(dtype=np.intp)
    return None


def _sizes(
    values: tuple[pd.DataFrame, pd.DataFrame],
    recordings: tuple[NDArray[np.intp], NDArray[np.intp]],
    column: str,
    rng: np.random.Generator,
    *,
    paired: bool,
) -> dict[str, float]:
    """Return the medians of one feature, and the shift between the sets with its interval."""
    first, second = (
        _by_recording(table[column].to_numpy(dtype=np.float64), of)
        for table, of in zip(values, recordings, strict=True)
    )
    drawn = [rng.integers(len(each), size=(RESAMPLES, len(each))) for each in (first, second)]
    if paired:
        shift, shifts = np.nanmedian(second - first), _medians((second - first)[drawn[0]])
    else:
        shift = np.nanmedian(second) - np.nanmedian(first)
        shifts = _medians(second[drawn[1]]) - _medians(first[drawn[0]])
    low, high = np.nanpercentile(shifts, [2.5, 97.5])
    return {
        "first": float(np.nanmedian(first)),
        "second": float(np.nanmedian(second)),
        "shift": float(shift),
        "low": float(low),
        "high": float(high),
    }


def _by_recording(values: NDArray[np.float64], recordings: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the values with a row for each recording, filled up with NaN."""
    robots = pd.Series(recordings).groupby(recordings).cumcount().to_numpy()
    rows = np.full((recordings.max() + 1, robots.max() + 1), np.nan)
    rows[recordings, robots] = values
    return rows


def _medians(resamples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of each resample; NaN where one has no value."""
    rows = resamples.reshape(len(resamples), -1)
    some = np.isfinite(rows).any(axis=1)
    medians = np.full(len(rows), np.nan)
    medians[some] = np.nanmedian(rows[some], axis=1)
    return medians


def _notes(first: Reference, second: Reference) -> Iterator[str]:
    given = {"A": given_numbers(first.table), "B": given_numbers(second.table)}
    for name, other in (("A", "B"), ("B", "A")):
        for topic, numbers in lacking_numbers(given[name], given[other]).items():
            yield f"{name} lacks {numbers} of {topic}, which all of the other set have."
    yield from (*first.notes, *second.notes)
    for name, each in (("A", first), ("B", second)):
        if (robots := len(each.table)) > (recordings := _count(each)):
            yield (
                f"{name} has {robots} robots in {recordings} recordings. Robots of one recording "
                "count as one recording, because they share its day."
            )
    if not (first.observations and second.observations):
        yield (
            "A set was read from tables, so topics, nodes and edges were not compared. "
            "Use folders of recordings."
        )
    sessions = [set(each.table["session"]) for each in (first, second)]
    if min(map(len, sessions)) == 1 and not sessions[0] & sessions[1]:
        yield (
            "One set comes from a single session that the other does not have, so a difference may "
            "be due to the session. Record both sets in the same sessions."
        )
