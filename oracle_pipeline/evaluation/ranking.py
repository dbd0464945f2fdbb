"""The rank of attacked runs among all runs: needs no threshold, and few runs suffice."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.evaluation.card_verdicts import RATE


@dataclass(frozen=True, slots=True)
class Ranking:
    """The number of the n attacked runs that are among the n highest scores (R-precision).

    Attributes
    ----------
    attacked, normal : int
        Runs with a score.
    on_top : int
        Attacked runs among that many highest scores; normal runs come first in ties.
    by_chance : float
        The number expected from a score without information.
    """

    attacked: int
    normal: int
    on_top: int
    by_chance: float

    @classmethod
    def of(cls, runs: pd.DataFrame) -> Self:
        """Rank runs by ``score``; those without one are left out."""
        scored = runs[np.isfinite(runs["score"])]
        malicious = is_malicious(scored)
        attacked = int(malicious.sum())
        order = np.lexsort((malicious, -scored["score"].to_numpy()))
        return cls(
            attacked=attacked,
            normal=len(scored) - attacked,
            on_top=int(malicious[order[:attacked]].sum()),
            by_chance=attacked**2 / max(1, len(scored)),
        )


def standing(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each mode, attacked ones first, by falling median score.

    Parameters
    ----------
    runs : DataFrame
        ``mode``, ``label``, ``score`` and ``p`` of each run.

    Returns
    -------
    DataFrame
        ``mode``, ``label``, ``runs``, ``judged`` (runs with a p-value), ``called`` (how many of
        those are anomalous at the usual rate) and ``median_score``.
    """
    called = runs["p"] <= RATE
    by_mode = runs.assign(called=called).groupby("mode", sort=False)
    table = by_mode.agg(
        label=("label", "first"),
        runs=("mode", "size"),
        judged=("p", "count"),
        called=("called", "sum"),
        median_score=("score", "median"),
    ).reset_index()
    order = np.lexsort((-table["median_score"].fillna(-np.inf), ~is_malicious(table)))
    return table.iloc[order].reset_index(drop=True)
