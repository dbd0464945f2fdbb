"""Splits of runs into different blocks for fitting, calibrating and testing.

Runs of a block share start, goals and nuisance seed, so whole blocks go to one side. Only normal
runs train: those of half the training blocks fit the detector, those of the other half calibrate
it. Hard negatives are normal runs like any other.
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
# What a detector has not seen of the runs that it is tested on.
BLOCK, HARMLESS = "block", "block and hard negatives"
SESSION: Final = "session"
WORLD: Final = "world"


@dataclass(frozen=True, eq=False, slots=True)
class Fold:
    """The rows that fit, calibrate and are tested in one fold; masks of shape (n_rows,)."""

    fit: NDArray[np.bool_]  # normal runs
    calibrate: NDArray[np.bool_]  # normal runs of other blocks
    test: NDArray[np.bool_]  # all runs of yet other blocks
    train: NDArray[np.bool_]  # all runs of no tested block: for classifiers, which need attacks too

    def of(self, rows: NDArray[np.intp]) -> "Fold":
        """Return the fold over rows that belong to runs, for example windows, by run number."""
        return Fold(self.fit[rows], self.calibrate[rows], self.test[rows], self.train[rows])


def block_folds(df: pd.DataFrame, seed: int, n_folds: int = FOLDS) -> list[Fold]:
    """Return folds that hold out a share of the blocks each, sessions spread evenly.

    Parameters
    ----------
    df : DataFrame
        One row for each run.
    seed : int
        Of the order in which blocks are dealt.
    n_folds : int
        Largest number of folds. With fewer blocks, each block is a fold; with fewer than three
        blocks, there are no folds.
    """
    rng = np.random.default_rng(seed)
    hand = _dealt(df, np.ones(len(df), dtype=np.bool_), n_folds, rng)
    return _folds(df, [hand == n for n in range(n_folds)], rng)


def group_folds(
    df: pd.DataFrame, column: Literal["session", "world"], seed: int, blocks_that_train: int = 0
) -> list[Fold]:
    """Return folds that hold out whole sessions or worlds, except some blocks that train.

    One group at a time is held out, or a fifth of them if there are more than five. With only one
    group, or where a group has no further block, there are no folds.

    Parameters
    ----------
    df : DataFrame
        One row for each run.
    column : {"session", "world"}
        What is held out.
    seed : int
        Of who trains, and of the order in which groups are dealt.
    blocks_that_train : int
        Blocks of a tested group that train like any other, such as runs taken on its day.
    """
    block, group = _column(df, "block"), df[column].to_numpy()
    rng = np.random.default_rng([seed, blocks_that_train])
    tested = [
        (group == name)
        & np.isin(block, rng.permutation(np.unique(block[group == name]))[blocks_that_train:])
        for name in np.unique(group)
    ]
    if len(tested) < 2 or not all(test.any() for test in tested):
        return []
    if len(tested) > FOLDS:
        hand = rng.permutation(len(tested)) % FOLDS
        tested = [np.any(np.array(tested)[hand == n], axis=0) for n in range(FOLDS)]
    return _folds(df, tested, np.random.default_rng(seed))


def tested_in(folds: Sequence[Fold]) -> NDArray[np.bool_] | None:
    """Return which rows some fold tests; None if there are no folds."""
    return np.any([fold.test for fold in folds], axis=0) if folds else None


def untaught(df: pd.DataFrame, folds: Sequence[Fold]) -> list[Fold]:
    """Return folds in which hard negatives are only tested, never trained on."""
    plain = ~is_hard_negative(df)
    held_out = [replace(f, fit=f.fit & plain, calibrate=f.calibrate & plain) for f in folds]
    return [fold for fold in held_out if fold.fit.any() and fold.calibrate.any()]


def fit_and_calibrate(
    df: pd.DataFrame, train: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Split the normal runs among the training rows, half of the blocks to either mask."""
    hand, normal = _dealt(df, train, 2, rng), ~is_malicious(df)
    return normal & (hand == 0), normal & (hand == 1)


def _folds(
    df: pd.DataFrame, held_out: Sequence[NDArray[np.bool_]], rng: np.random.Generator
) -> list[Fold]:
    folds = []
    for test in held_out:
        fit, calibrate = fit_and_calibrate(df, ~test, rng)
        if test.any() and fit.any() and calibrate.any():
            folds.append(Fold(fit, calibrate, test, ~test))
    return folds


def _dealt(
    df: pd.DataFrame, rows: NDArray[np.bool_], hands: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Deal the blocks of some rows like cards, session by session; -1 for all other rows.

    Sessions come in a random order: those of a single block are not dealt in turns.
    """
    blocks, first, member = np.unique(
        _column(df, "block")[rows], return_index=True, return_inverse=True
    )
    names, session = np.unique(_column(df, "session")[rows][first], return_inverse=True)
    order = rng.permutation(len(blocks))
    cards = np.lexsort((order, rng.permutation(len(names))[session]))
    hand = np.full(len(df), -1)
    hand[rows] = (np.argsort(cards) % hands)[member]
    return hand


def _column(df: pd.DataFrame, name: str) -> NDArray[np.int64]:
    return df[name].to_numpy(dtype=np.int64)
