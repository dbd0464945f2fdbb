"""Which recordings of a reference count: normal ones, copies once, and none that is unlike all.

A recording that failed, with recoveries or an attack by mistake, raises the score that others
must exceed. Up to a tenth of the recordings are set aside if their scores are far above all others.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.terminal import join_first
from oracle_pipeline.datasets import feature_columns, is_malicious, signal_columns
from oracle_pipeline.scoring.reference import Reference

MOST_ODD = 0.1  # share of the recordings that may be set aside
GAP = 2.0  # an odd score is so many times the highest of the others
LEAST_SCORE = 10.0  # and at least this, in spreads of the normal scores


def counted(reference: Reference) -> Reference:
    """Return a reference without attacked runs, and with copies of a recording once."""
    kept, notes = ~is_malicious(reference.table), []
    if left_out := int(np.sum(~kept)):
        notes.append(f"{left_out} attacked runs of the reference are left out.")
    measured = [*feature_columns(reference.table), *signal_columns(reference.table)]
    values = reference.table[measured].to_numpy(dtype=np.float64)
    same = pd.DataFrame({"values": list(map(bytes, values)), "label": reference.table["label"]})
    copies = same.duplicated().to_numpy() & kept
    if copies.any():
        names = _named(reference, copies)
        notes.append(f"{names}: the same as another recording, which counts once.")
    return selected(reference, kept & ~copies, notes)


def selected(reference: Reference, rows: NDArray[np.bool_], notes: Sequence[str]) -> Reference:
    """Return some rows of a reference, with further notes before its own."""
    return replace(
        reference,
        table=reference.table[rows],
        observations=tuple(itertools.compress(reference.observations, rows)),
        notes=(*notes, *reference.notes),
    )


def without_odd(reference: Reference, scores: NDArray[np.float64]) -> Reference | None:
    """Return a reference without the recordings that are unlike all others; None if none is.

    Parameters
    ----------
    reference : Reference
    scores : ndarray of shape (n_runs,)
        Held out, of each row of its table, in spreads of the normal scores.
    """
    rows = odd(scores)
    if not rows.any():
        return None
    share = f"{rows.sum()} of {len(rows)}"
    note = (
        f"{_named(reference, rows)}: set aside, because it is far unlike the other normal "
        f"recordings. Such recordings are called anomalous too: {share} normal ones here."
    )
    return selected(reference, ~rows, [note])


def odd(scores: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which scores are far above all others: at most a tenth of them.

    Examples
    --------
    >>> odd(np.array([0.1] * 18 + [4.0, 60.0])).nonzero()[0].tolist()
    [19]
    """
    most = int(MOST_ODD * len(scores))
    highest = np.sort(scores)[::-1]
    for count in range(most, 0, -1):
        if highest[count - 1] >= max(LEAST_SCORE, GAP * highest[count]):
            return np.asarray(scores >= highest[count - 1], dtype=np.bool_)
    return np.zeros(len(scores), dtype=np.bool_)


def recordings_for(count: int, blocks: int) -> int:
    """Return how many recordings survive some odd ones, and keep a number of blocks.

    Examples
    --------
    >>> [recordings_for(count, 19) for count in (1, 2, 3)]
    [20, 21, 30]
    """
    return max(math.ceil(count / MOST_ODD), blocks + count)


def _named(reference: Reference, rows: NDArray[np.bool_]) -> str:
    return join_first(reference.table.loc[rows, "run_id"].tolist())
