"""The weakest attack that the oracle detects: kill matrix, mutation score, detectable magnitude.

A grid of attacked runs, one operator of the scenario language at several magnitudes, is scored by
an oracle that was fitted on the campaign. A run that is called anomalous is a killed mutant. A run
without an altered message is an equivalent mutant and is left out. ``oracle-sim grid`` records the
grid.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.terminal import join_first
from oracle_pipeline.datasets import DatasetError, is_hard_negative
from oracle_pipeline.evaluation.card_verdicts import RATE, card_verdicts
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate
from oracle_pipeline.evaluation.held_out import calibration_runs
from oracle_pipeline.evaluation.metrics import share
from oracle_pipeline.evaluation.splits import (
    BLOCK,
    HARMLESS,
    Fold,
    fit_and_calibrate,
    without_hard_negatives,
)
from oracle_pipeline.scoring.conformal import check_support, runs_needed
from oracle_pipeline.scoring.feature_sets import feature_sets
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

OPERATOR = ("scenario", "parameter")
MAGNITUDE = ("split", *OPERATOR, "value")
REQUIRED = (*OPERATOR, "value", "changed_messages")
DETECTABLE = 0.9  # detection rate from which a magnitude counts as detectable


def kill_matrix(campaign: MeasuredRuns, grid: MeasuredRuns, seed: int) -> pd.DataFrame:
    """Return which runs of a grid a reference card kills, by features alone.

    A card is learned once with hard negatives and once without (``split``), since an oracle that
    knows harmless changes accepts weaker attacks. It learns from normal runs of blocks that the
    grid does not use: a grid made offline mutates runs of the campaign.

    Parameters
    ----------
    campaign : Runs
    grid : Runs
        The grid's runs with the same features and the columns ``scenario``, ``parameter``,
        ``value`` (magnitude, growing with strength) and ``changed_messages``.
    seed : int
        Of the split.

    Returns
    -------
    DataFrame
        A row for each split and mutant: ``scenario``, ``parameter``, ``value``, ``block``,
        ``changed_messages`` and ``killed``.

    Raises
    ------
    DatasetError
        The grid lacks a column, or the campaign has no features.
    ConformalError
        Too few normal runs are left to calibrate with.
    """
    sets = feature_sets(campaign.features)
    if not sets.get("all"):
        raise DatasetError("No feature of the campaign has a finite value; extract them again.")
    absent = [c for c in (*REQUIRED, *sets["all"]) if c not in grid.features.columns]
    if absent:
        raise DatasetError(
            f"The grid lacks the columns {join_first(absent)}; use the index that "
            "`oracle-sim grid` writes, and extract its features with the campaign's plugins."
        )
    runs = campaign.concat(grid)
    mutants = np.arange(len(runs.features)) >= len(campaign.features)
    fold = _fold(runs, mutants, seed)
    check_support(calibration_runs([fold]), RATE)
    splits = {BLOCK: [fold]}
    plain = without_hard_negatives(runs.features, [fold])
    if is_hard_negative(campaign.features).any() and calibration_runs(plain) >= runs_needed(RATE):
        splits[HARMLESS] = plain
    tables = []
    for split, folds in splits.items():
        killed = card_verdicts(runs, folds).scores().p[mutants] <= RATE
        tables.append(grid.features[[*REQUIRED, "block"]].assign(split=split, killed=killed))
    return pd.concat(tables, ignore_index=True)


def _fold(runs: MeasuredRuns, mutants: NDArray[np.bool_], seed: int) -> Fold:
    """Return the fold that tests the mutants, fitted on other blocks only."""
    train = ~np.isin(runs.block, runs.block[mutants])
    fit, calibrate = fit_and_calibrate(runs.features, train, np.random.default_rng(seed))
    return Fold(fit, calibrate, mutants, train)


def kill_rates(killed: pd.DataFrame, by: Sequence[str], rng: np.random.Generator) -> pd.DataFrame:
    """Return the share of mutants that are killed in each group, equivalent ones left out.

    Parameters
    ----------
    killed : DataFrame
        From `kill_matrix`.
    by : sequence of str
        Columns that name a group: `MAGNITUDE`, or ``split`` for the mutation score.
    rng : Generator
        Draws the blocks for the intervals: mutants of one block resemble each other.
    """
    rows = []
    for place, of in killed.groupby(list(by)):
        mutants = of[of["changed_messages"] > 0]
        hit, block = (mutants[name].to_numpy() for name in ("killed", "block"))
        row = dict(zip(by, place, strict=True)) | {
            "mutants": len(of),
            "equivalent": len(of) - len(mutants),
            "killed": int(hit.sum()),
        }
        rows.append(row | share(hit, block, rng).columns("kill_rate"))
    return pd.DataFrame(rows)


def minimum_detectable(kills: pd.DataFrame) -> pd.DataFrame:
    """Return for each split and operator the smallest magnitude that is detected reliably.

    This is the smallest magnitude of the grid from which on at least 0.9 of the mutants are killed;
    NaN if there is none. The true value lies between it and the next smaller magnitude of the grid
    (``magnitude_low``; 0 below the first).

    Parameters
    ----------
    kills : DataFrame
        From `kill_rates`, by `MAGNITUDE`.
    """
    rows = []
    for place, of in kills.groupby(["split", *OPERATOR], sort=False):
        counted = of[of["mutants"] > of["equivalent"]].sort_values("value")
        values = [0.0, *counted["value"]]
        missed = np.flatnonzero(counted["kill_rate"].to_numpy() < DETECTABLE)
        first = int(missed[-1]) + 2 if len(missed) else 1
        magnitude = NOTHING
        if first < len(values):
            magnitude = Estimate(values[first], values[first - 1], values[first])
        rows.append(
            dict(zip(["split", *OPERATOR], place, strict=True)) | magnitude.columns("magnitude")
        )
    return pd.DataFrame(rows)
