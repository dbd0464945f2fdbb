"""Recordings that are longer or shorter than all normal recordings of a reference.

Another length is not another behaviour. What depends on the length, such as the time with a goal
or the share of messages at the start, is left out then: what the robot did for each metre, minute
or planned metre are features of their own. How the scores of such a recording count is in
``CrossConformalScorer.scores``.
"""

import json
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oracle_pipeline.datasets import MISSING, feature_columns, field_metadata
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.windows import HOP_S, WINDOW_S

CLEARLY = 0.1  # share of the lengths, by which a recording has another one
_DEPENDS = "it depends on the length of a recording"


def comparable_tables(
    tables: FeatureTables, lengths: tuple[int, int] | None
) -> tuple[FeatureTables, tuple[str, ...]]:
    """Return the tables to compare with recordings of other lengths, and a note on it.

    Parameters
    ----------
    tables : FeatureTables
        Of one recording.
    lengths : tuple of int or None
        ``CrossConformalScorer.lengths``.
    """
    if lengths is None or not is_outside(len(tables.windows), lengths):
        return tables, ()
    windows = len(tables.windows)
    fields = field_metadata(tables.run)
    dependent = [
        column
        for column in feature_columns(tables.run)
        if fields.get(column, {}).get("extensive") == "true"
    ]
    reasons = json.loads(tables.run[MISSING].iloc[0]) | dict.fromkeys(dependent, _DEPENDS)
    run = tables.run.assign(**dict.fromkeys(dependent, math.nan), **{MISSING: json.dumps(reasons)})
    run.attrs = tables.run.attrs
    note = (
        f"It is {'longer' if windows > lengths[1] else 'shorter'} than all normal recordings: "
        f"{_seconds(windows)} s against {_seconds(lengths[0])} to {_seconds(lengths[1])} s. It is "
        "judged by rates and windows."
    )
    return FeatureTables(run, tables.windows), (note,)


def is_outside(windows: ArrayLike, lengths: tuple[int, int] | None) -> NDArray[np.bool_]:
    """Return whether so many windows are clearly fewer or more than all normal recordings have."""
    counts, (shortest, longest) = np.asarray(windows), lengths or (0, math.inf)
    return np.asarray((counts < (1 - CLEARLY) * shortest) | (counts > (1 + CLEARLY) * longest))


def _seconds(windows: int) -> str:
    return f"{HOP_S * (windows - 1) + WINDOW_S:g}"
