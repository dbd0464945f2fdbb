"""Splits of runs into different blocks for fitting, calibrating and testing.

Runs of a block share start, goals and nuisance seed, so blocks are never split. Only normal runs
are used for training: those of half the training blocks to fit the detector, the others to
calibrate it. Hard negatives are normal runs like any other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import is_hard_negative, is_malicious

FOLDS = 5
MIN_BLOCKS = 3  # one to fit, one to calibrate, one to test
# What is held out.
BLOCK, HARMLESS = "block", "block and hard negatives"
SESSION: Final = "session"
WORLD: Final = "world"


@dataclass(frozen=True, eq=False, slots=True)
class Fold:
    """The rows that fit, calibrate and are tested in one fold; masks of shape (n_rows,)."""

    fit: NDArray[np.bool_]  # normal runs
    calibrate: NDArray[np.bool_]  # normal runs of other blocks
    test: NDArray[np.bool_]  # all runs of yet other blocks
    train: NDArray[np.bool_]  # all runs of untested blocks, attacked too: for classifiers

    def of(self, rows: NDArray[np.intp]) -> "Fold":
        """Return the fold over rows that belong to runs, for example windows, by run number."""
        return Fold(self.fit[rows], self.calibrate[rows], self.test[rows], self.train[rows])


def block_folds(df: pd.DataFrame, seed: int) -> list[Fold]:
    """Return folds that each hold out a share of the blocks, with sessions spread evenly.

    There are `FOLDS`. With fewer blocks, each block is a fold; with fewer than three, there are no
    folds.

    Parameters
    ----------
    df : DataFrame
        One row for each run.
    seed : int
        Of the assignment of blocks to folds.
    """
    rng = np.random.default_rng(seed)
    group = _assign_blocks(df, np.ones(len(df), dtype=np.bool_), FOLDS, rng)
    return _folds(df, [group == n for n in range(FOLDS)], rng)


def group_folds(df: pd.DataFrame, column: Literal["session", "world"], seed: int) -> list[Fold]:
    """Return folds that hold out whole sessions or worlds.

    One group at a time is held out, or a fifth of them if there are more than five. There are no
    folds with only one group.

    Parameters
    ----------
    df : DataFrame
        One row for each run.
    column : {"session", "world"}
        What is held out.
    seed : int
        Of the assignment of groups to folds.
    """
    names, group = np.unique(df[column].to_numpy(), return_inverse=True)
    if len(names) < 2:
        return []
    fold = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    tested = [np.asarray(fold[group] == n) for n in range(min(FOLDS, len(names)))]
    return _folds(df, tested, np.random.default_rng(seed))


def within_one_card(df: pd.DataFrame) -> list[Fold]:
    """Return one fold that learns from all normal runs and tests all runs."""
    everything = np.ones(len(df), dtype=np.bool_)
    return [Fold(~is_malicious(df), ~everything, everything, everything)]


def tested_in(folds: Sequence[Fold]) -> NDArray[np.bool_]:
    """Return a mask of the rows that any fold tests."""
    return np.asarray(np.any([fold.test for fold in folds], axis=0), dtype=np.bool_)


def without_hard_negatives(df: pd.DataFrame, folds: Sequence[Fold]) -> list[Fold]:
    """Return folds in which hard negatives are only tested, never trained on."""
    plain = ~is_hard_negative(df)
    held_out = [replace(f, fit=f.fit & plain, calibrate=f.calibrate & plain) for f in folds]
    return [fold for fold in held_out if fold.fit.any() and fold.calibrate.any()]


def fit_and_calibrate(
    df: pd.DataFrame, train: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Split the normal runs among the training rows by block into two halves."""
    half, normal = _assign_blocks(df, train, 2, rng), ~is_malicious(df)
    return normal & (half == 0), normal & (half == 1)


def _folds(
    df: pd.DataFrame, held_out: Sequence[NDArray[np.bool_]], rng: np.random.Generator
) -> list[Fold]:
    folds = []
    for test in held_out:
        fit, calibrate = fit_and_calibrate(df, ~test, rng)
        if test.any() and fit.any() and calibrate.any():
            folds.append(Fold(fit, calibrate, test, ~test))
    return folds


def _assign_blocks(
    df: pd.DataFrame, rows: NDArray[np.bool_], groups: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Assign the blocks of some rows round-robin to groups; -1 for all other rows.

    Blocks are ordered by session, and sessions at random.
    """
    blocks, first, member = np.unique(
        _column(df, "block")[rows], return_index=True, return_inverse=True
    )
    names, session = np.unique(_column(df, "session")[rows][first], return_inverse=True)
    order = rng.permutation(len(blocks))
    sequence = np.lexsort((order, rng.permutation(len(names))[session]))
    group = np.full(len(df), -1)
    group[rows] = (np.argsort(sequence) % groups)[member]
    return group


def _column(df: pd.DataFrame, name: str) -> NDArray[np.int64]:
    return df[name].to_numpy(dtype=np.int64)
