"""Draws rows from a table of runs with replacement, and finds the distinct runs among them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import DatasetError, is_malicious


def bootstrap(df: pd.DataFrame, n: int, malicious_rate: float, seed: int) -> pd.DataFrame:
    """Draw ``n`` rows with replacement, a fixed share of them attacked.

    Copies add no information. Each row keeps its ``run_id``, and `distinct_runs` counts the
    distinct runs.

    Parameters
    ----------
    df : DataFrame
        One row for each run.
    n : int
        Rows to draw.
    malicious_rate : float
        Share of the rows that are drawn from the attacked runs, in [0, 1].
    seed : int
        Seed of the random generator.

    Returns
    -------
    DataFrame of n rows
        In the order of `df`.

    Raises
    ------
    DatasetError
        The sizes are invalid, or a class to draw from has no run.
    """
    if n < 1 or not 0.0 <= malicious_rate <= 1.0:
        raise DatasetError(
            f"Cannot draw {n} rows with a malicious rate of {malicious_rate}; "
            "give at least 1 row and a rate from 0 to 1."
        )
    malicious = is_malicious(df)
    rng = np.random.default_rng(seed)
    n_malicious = round(n * malicious_rate)
    drawn = []
    for wanted, size, name in (
        (malicious, n_malicious, "malicious"),
        (~malicious, n - n_malicious, "normal"),
    ):
        if size and not wanted.any():
            raise DatasetError(
                f"There is no {name} run to draw {size} rows from; record runs of a {name} mode "
                f"or set the malicious rate to {1 if name == 'normal' else 0}."
            )
        if size:
            drawn.append(rng.choice(np.flatnonzero(wanted), size))
    return df.iloc[np.sort(np.concatenate(drawn))].reset_index(drop=True)


@dataclass(frozen=True, eq=False, slots=True)
class DistinctRuns:
    """The distinct runs among rows; arrays of shape (n_runs,), sorted by ``run_id``."""

    first: NDArray[np.intp]  # row of the run's first copy
    copies: NDArray[np.int64]  # number of rows of the run
    malicious: NDArray[np.bool_]
    block: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.first)

    @classmethod
    def once(
        cls, members: NDArray[np.bool_], malicious: NDArray[np.bool_], block: NDArray[np.int64]
    ) -> "DistinctRuns":
        """Return the members among rows that are distinct already; arrays of shape (n_rows,)."""
        first = np.flatnonzero(members)
        copies = np.ones(len(first), dtype=np.int64)
        return cls(first, copies, malicious[first], block[first])


def distinct_runs(df: pd.DataFrame) -> DistinctRuns:
    """Return the distinct runs of a table and their numbers of rows."""
    _, first, copies = np.unique(
        df["run_id"].to_numpy(dtype=object), return_index=True, return_counts=True
    )
    return DistinctRuns(
        first=first,
        copies=copies,
        malicious=is_malicious(df)[first],
        block=df["block"].to_numpy(dtype=np.int64)[first],
    )


def lacking(df: pd.DataFrame) -> str:
    """Return a text on the class of runs that a table lacks; empty if it has both."""
    malicious = is_malicious(df)
    absent = [
        name for name, rows in (("malicious", malicious), ("normal", ~malicious)) if not rows.any()
    ]
    return f"no {' and no '.join(absent)} runs" if absent else ""
