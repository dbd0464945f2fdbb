"""Finds features that distinguish unaltered runs, on which a verdict must not depend.

A shadow control computes the attack, but forwards the original messages. It has the same block,
graph and random numbers as its passthrough. A feature that distinguishes the two describes the
experiment and not the robot. The same holds for a feature that distinguishes two unaltered modes
(by their subscriptions) or sessions.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest, false_discovery_control, kruskal

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.datasets import feature_columns, feature_floors

_Row: TypeAlias = tuple[str, str, str, float, float]

COLUMNS = ("feature", "tells", "between", "differing", "p")

BLOCKS_OF_SESSION = 3  # fewer show no difference between sessions
LEVEL = 0.05  # false discovery rate among the features of one comparison


def exact_pairs(df: pd.DataFrame) -> list[tuple[str, str]]:
    """Return the pairs of a passthrough and its shadow in a table; their graphs are equal."""
    modes = set(df["mode"])
    pairs = [(control, f"{attacked}_shadow") for control, attacked in PAIRS]
    return [pair for pair in pairs if modes.issuperset(pair)]


def unmatched(df: pd.DataFrame) -> list[str]:
    """Return the attacked modes without an unaltered counterpart (control or shadow).

    A feature that distinguishes modes can identify runs of such a mode without the attack.
    """
    modes, control_of = set(df["mode"]), {attacked: control for control, attacked in PAIRS}
    attacked = dict.fromkeys(df.loc[df["label"] == "malicious", "mode"])
    return [m for m in attacked if not modes & {f"{m}_shadow", control_of.get(m, "")}]


def blocks_needed(features: int) -> int:
    """Return the number of blocks needed to find one of that many features significant."""
    return int(np.ceil(np.log2(2.0 * max(1, features) / LEVEL)))


def audit(df: pd.DataFrame, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """List every feature that distinguishes controls, modes or sessions of unaltered runs.

    A sign test over blocks compares two modes, and a Kruskal-Wallis test over blocks compares
    sessions, or earlier with later sessions if each has few blocks. Differences below the floor of
    a feature count as zero.

    Parameters
    ----------
    df : DataFrame
        A row for each run. Attacked runs and modes that change something are ignored.
    columns : sequence of str, optional
        All features by default.

    Returns
    -------
    DataFrame
        A row for each feature, the most certain first: ``tells`` says what it distinguishes,
        ``between`` two modes or the sessions, ``differing`` in which share of the blocks by more
        than its floor, and ``p`` is adjusted for the number of compared features.
    """
    chosen = feature_columns(df) if columns is None else list(columns)
    found = [*_between_modes(df, chosen), *_between_sessions(df, chosen)]
    return pd.DataFrame(found, columns=COLUMNS).sort_values(["p", "feature"], ignore_index=True)


def _features_differing_in_pair(
    df: pd.DataFrame, columns: Sequence[str], pair: tuple[str, str]
) -> list[_Row]:
    """Return the features that distinguish two unaltered modes."""
    one, other = (
        df[df["mode"] == mode].set_index("block")[list(columns)].sort_index() for mode in pair
    )
    blocks = one.index.intersection(other.index)
    differences = other.loc[blocks].to_numpy() - one.loc[blocks].to_numpy()
    floors = feature_floors(df)
    floor = np.array([floors.get(column, 0.0) for column in columns])
    more, less = (differences > floor).sum(axis=0), (differences < -floor).sum(axis=0)
    p = [
        binomtest(int(up), int(up + down)).pvalue if up + down else 1.0
        for up, down in zip(more, less, strict=True)
    ]
    share = (more + less) / max(1, len(blocks))
    exact = pair[1].endswith("_shadow")
    return _significant(columns, "control" if exact else "mode", " and ".join(pair), share, p)


def _between_modes(df: pd.DataFrame, columns: Sequence[str]) -> Iterator[_Row]:
    passthrough = [control for control, _ in PAIRS if control in set(df["mode"])]
    for pair in (*exact_pairs(df), *combinations(dict.fromkeys(passthrough), 2)):
        yield from _features_differing_in_pair(df, columns, pair)


def _between_sessions(df: pd.DataFrame, columns: Sequence[str]) -> list[_Row]:
    unaltered = df[df["mode"].isin([control for control, _ in PAIRS])]
    by_block = unaltered.groupby(["session", "block"])[list(columns)].mean()
    groups, between = [group for _, group in by_block.groupby("session")], "sessions"
    if sum(len(group) >= BLOCKS_OF_SESSION for group in groups) < 2:
        later = by_block.index.get_level_values("session") >= unaltered["session"].median()
        groups, between = [by_block[~later], by_block[later]], "earlier and later sessions"
    groups = [group for group in groups if len(group) >= BLOCKS_OF_SESSION]
    if len(groups) < 2:
        return []
    p = [_p_equal([group[column].dropna().to_numpy() for group in groups]) for column in columns]
    return _significant(columns, "session", between, np.full(len(columns), np.nan), p)


def _p_equal(samples: list[NDArray[np.float64]]) -> float:
    """Return the p-value of the test for equal distributions; 1 where nothing varies."""
    samples = [sample for sample in samples if len(sample)]
    if len(samples) < 2 or np.ptp(np.concatenate(samples)) == 0.0:
        return 1.0
    return float(kruskal(*samples).pvalue)


def _significant(
    columns: Sequence[str], tells: str, between: str, share: NDArray[np.float64], p: list[float]
) -> list[_Row]:
    adjusted: list[float] = false_discovery_control(p).tolist() if p else []
    return [
        (column, tells, between, float(differing), float(p_adjusted))
        for column, differing, p_adjusted in zip(columns, share, adjusted, strict=True)
        if p_adjusted <= LEVEL
    ]
