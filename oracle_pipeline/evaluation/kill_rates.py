"""The weakest attack that the oracle detects: kill matrix, mutation score, detectable magnitude.

A grid of attacked runs, one operator of the scenario language at several magnitudes, is scored by
an oracle that was fitted on the campaign. A run that is called anomalous is a killed mutant. A run
without an altered message is an equivalent mutant and is left out. ``oracle-sim grid`` records the
grid.
"""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import DatasetError, is_hard_negative
from oracle_pipeline.evaluation.comparisons import HEADLINE, RATES
from oracle_pipeline.evaluation.estimate import NOTHING, Estimate, clopper_pearson
from oracle_pipeline.evaluation.held_out import calibration_runs
from oracle_pipeline.evaluation.reference_scores import reference_scores
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

OPERATOR = ["scenario", "parameter"]
REQUIRED = ("scenario", "parameter", "value", "changed_messages")
DETECTABLE = 0.9  # detection rate from which a magnitude counts as detectable


def kill_matrix(
    campaign: MeasuredRuns, grid: MeasuredRuns, seed: int, rate: float = RATES[0]
) -> pd.DataFrame:
    """Return how many runs of each magnitude the headline's scorer kills.

    It is learned once with hard negatives and once without (``split``), since an oracle that knows
    harmless changes accepts weaker attacks. It learns from normal runs of blocks that the grid does
    not use: a grid made offline mutates runs of the campaign.

    Parameters
    ----------
    campaign : Runs
    grid : Runs
        The grid's runs with the same features and the columns ``scenario``, ``parameter``,
        ``value`` (magnitude, growing with strength) and ``changed_messages``.
    seed : int
        Of the split.
    rate : float
        False positive rate of the verdicts.

    Returns
    -------
    DataFrame
        A row for each split, scenario, parameter and value, with ``mutants``, ``equivalent``,
        ``killed`` and the estimate ``kill_rate`` among those that are not equivalent.

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
            f"The grid lacks the columns {', '.join(absent[:5])}; use the index that "
            "`oracle-sim grid` writes, and extract its features with the campaign's plugins."
        )
    runs = campaign.concat(grid)
    mutants = np.arange(len(runs.features)) >= len(campaign.features)
    fold = _fold(runs, mutants, seed)
    check_support(calibration_runs([fold]), rate)
    splits = {BLOCK: [fold]}
    plain = without_hard_negatives(runs.features, [fold])
    if is_hard_negative(campaign.features).any() and calibration_runs(plain) >= runs_needed(rate):
        splits[HARMLESS] = plain
    tables = []
    for split, folds in splits.items():
        killed = reference_scores(runs, folds, HEADLINE.features).p[mutants] <= rate
        verdicts = grid.features[list(REQUIRED)].assign(killed=killed)
        tables.append(_counted(verdicts).assign(split=split))
    columns = ["split", *OPERATOR, "value", "mutants", "equivalent", "killed"]
    kills = pd.concat(tables, ignore_index=True)
    return kills[[*columns, "kill_rate", "kill_rate_low", "kill_rate_high"]]


def _fold(runs: MeasuredRuns, mutants: NDArray[np.bool_], seed: int) -> Fold:
    """Return the fold that tests the mutants, fitted on other blocks only."""
    train = ~np.isin(runs.block, runs.block[mutants])
    fit, calibrate = fit_and_calibrate(runs.features, train, np.random.default_rng(seed))
    return Fold(fit, calibrate, mutants, train)


def _counted(verdicts: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for place, runs in verdicts.groupby([*OPERATOR, "value"], sort=True):
        mutants = runs[runs["changed_messages"] > 0]
        killed = int(mutants["killed"].sum())
        rate = killed / len(mutants) if len(mutants) else np.nan
        rows.append(
            {
                **dict(zip([*OPERATOR, "value"], place, strict=True)),
                "mutants": len(runs),
                "equivalent": len(runs) - len(mutants),
                "killed": killed,
                **clopper_pearson(rate, len(mutants)).columns("kill_rate"),
            }
        )
    return pd.DataFrame(rows)


def mutation_scores(kills: pd.DataFrame) -> pd.DataFrame:
    """Return the share of mutants that are killed in each split, equivalent ones left out.

    Parameters
    ----------
    kills : DataFrame
        From `kill_matrix`.
    """
    rows = []
    for split, of in kills.groupby("split", sort=False):
        mutants, killed = int((of["mutants"] - of["equivalent"]).sum()), int(of["killed"].sum())
        score = clopper_pearson(killed / mutants, mutants) if mutants else NOTHING
        counts = {"split": split, "mutants": mutants, "killed": killed}
        rows.append(counts | score.columns("mutation_score"))
    return pd.DataFrame(rows)


def minimum_detectable(kills: pd.DataFrame) -> pd.DataFrame:
    """Return for each split and operator the smallest magnitude that is detected reliably.

    This is the smallest magnitude of the grid from which on at least 0.9 of the mutants are killed;
    NaN if there is none. The true value lies between it and the next smaller magnitude of the grid
    (``magnitude_low``; 0 below the first).

    Parameters
    ----------
    kills : DataFrame
        From `kill_matrix`.
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
