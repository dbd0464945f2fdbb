"""Compares kinds of oracle: detected attacks, false positives and cost of each."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.datasets import is_hard_negative, read_table
from oracle_pipeline.evaluation.card_verdicts import RATE, card_folds, card_verdicts
from oracle_pipeline.evaluation.metrics import auc, share
from oracle_pipeline.oracles.calibration import KindScores, calibrated, union
from oracle_pipeline.oracles.kind import OracleKind, TracedRuns
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

UNION = "union"
CARD = "reference card"  # the scorer of `oracle score`, for comparison
SEED = 50

Row = dict[str, float | int | str]


@dataclass(frozen=True, eq=False, slots=True)
class KindsComparison:
    """The results of several oracles on the same runs.

    Attributes
    ----------
    oracles : DataFrame
        A row for each oracle: the input it needs from people, its cost, and its rates.
    p : DataFrame
        A row for each run: its name, mode and label, and a column of p-values for each oracle.
    """

    oracles: pd.DataFrame
    p: pd.DataFrame


def compare_kinds(
    kinds: Sequence[OracleKind],
    runs: TracedRuns,
    others: Mapping[str, KindScores] | None = None,
    rate: float = RATE,
    progress: Callable[[str], None] = lambda _: None,
) -> KindsComparison:
    """Judge the same runs by several kinds of oracle, sessions held out.

    Parameters
    ----------
    kinds : sequence of OracleKind
        Unfitted. A kind that cannot be used on members runs gets a row with the reason.
    runs : TracedRuns
        Normal and attacked runs.
    others : mapping of str to KindScores, optional
        Results of other oracles on members runs, for comparison; they are not in the union.
    rate : float
        False positive rate of every verdict, including that of the union.
    progress : callable
        Called with one line before each step.
    """
    rng = np.random.default_rng(SEED)
    rows: list[Row] = []
    verdicts: dict[str, KindScores] = {}
    for kind in kinds:
        progress(kind.name)
        cost: Row = {"oracle": kind.name, "asks": kind.asks}
        alone = TracedRuns(runs.table, runs.traces)  # without caches, to measure the full cost
        began_s = time.process_time()
        try:
            verdicts[kind.name] = calibrated(kind, alone)
        except OracleError as error:
            rows.append({**cost, "note": str(error)})
            continue
        seconds = (time.process_time() - began_s) / len(runs.traces)
        rows.append({**cost, "seconds_a_run": seconds})
    if len(verdicts) > 1:
        progress(UNION)
        verdicts[UNION] = union(list(verdicts.values()), runs)
        rows.append({"oracle": UNION, "asks": "what its members need"})
    for name, other in (others or {}).items():
        verdicts[name] = other
        rows.append({"oracle": name, "asks": "normal recordings"})
    for row in rows:
        if (verdict := verdicts.get(str(row["oracle"]))) is not None:
            row.update(_rates(verdict, runs, rate, rng))
    p = pd.DataFrame({name: verdict.p for name, verdict in verdicts.items()})
    p = pd.concat([runs.table[["run_id", "mode", "label"]], p], axis=1)
    return KindsComparison(pd.DataFrame(rows), p)


def by_cards(roots: Sequence[Path], runs: TracedRuns) -> dict[str, KindScores]:
    """Return the scores of a reference card for the runs of a root, if it has their features.

    Parameters
    ----------
    roots : sequence of Path
        The first root that has ``datasets/`` with all runs is used.
    runs : TracedRuns
        All must be in its table of features.
    """
    for root in roots:
        features, windows = layout.dataset(root, "features"), layout.dataset(root, "windows")
        if not features.is_file() or not windows.is_file():
            continue
        table = read_table(features)
        if set(runs.table["run_id"]) <= set(table["run_id"]):
            rows = table[table["run_id"].isin(runs.table["run_id"])]
            measured = MeasuredRuns.ordered(rows, read_table(windows))
            scores = card_verdicts(measured, card_folds(measured.features, SEED)).scores()
            order = np.searchsorted(np.sort(rows["run_id"]), runs.table["run_id"])
            return {CARD: KindScores(scores.score[order], scores.p[order])}
    return {}


def _rates(verdict: KindScores, runs: TracedRuns, rate: float, rng: np.random.Generator) -> Row:
    """Return AUC, detection rate and realised false positive rates, each with its interval."""
    called, block = verdict.p <= rate, runs.block
    blocks, needed = len(np.unique(block[runs.normal])), runs_needed(rate) + 1
    supported = blocks >= needed  # a run's own block has no vote
    harmless = is_hard_negative(runs.table)
    distinct = DistinctRuns.once(runs.malicious | runs.normal, runs.malicious, block)
    row: Row = {"rate": rate, **auc(verdict.score[distinct.first], distinct, rng).columns("auc")}
    for name, group in (
        ("detection_rate", runs.malicious),
        ("false_alarm_rate", runs.normal),
        ("false_alarm_rate_harmless", harmless),
    ):
        row |= share(called[group], block[group], rng).columns(name) if supported else {}
    if not supported:
        row["note"] = (
            f"{blocks} blocks of normal runs cannot support a false positive rate of {rate:g}: "
            f"record {needed}, or allow a higher rate"
        )
    return row
