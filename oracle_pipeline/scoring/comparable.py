"""Selects the features and normal runs of a reference for comparison with one recording."""

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import (
    MISSING,
    feature_columns,
    field_metadata,
    is_malicious,
    signal_columns,
)
from oracle_pipeline.scoring.feature_sets import feature_sets
from oracle_pipeline.scoring.verdict import ScoringError

LISTED = 5  # most features or reasons named in a note


class Comparable(NamedTuple):
    """The part of a reference that one recording is compared with."""

    columns: list[str]  # features present in both
    normal_runs: pd.DataFrame  # of the same kind of system and of other blocks
    notes: list[str]  # which features and runs are left out, and why


def comparable(row: pd.DataFrame, reference: pd.DataFrame) -> Comparable:
    """Return the features and the normal runs to compare a recording with.

    Parameters
    ----------
    row : DataFrame of one row
        The features of the recording. If it is one of the reference runs, its block is left out.
    reference : DataFrame
        One row per run.

    Raises
    ------
    ScoringError
        The reference and the recording share no feature, or a feature has different units.
    """
    candidates = feature_sets(reference).get("all", [])
    columns, notes = shared_features(row, reference, candidates)
    normal_runs = _normal_runs(row, reference, columns, notes)
    return Comparable(columns, normal_runs, notes)


def shared_features(
    row: pd.DataFrame, reference: pd.DataFrame, candidates: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Return the features that a recording and the reference share, and a note on the others.

    Raises
    ------
    ScoringError
        They share no feature, or a feature has different units.
    """
    fields, own = field_metadata(reference), field_metadata(row)
    columns = [c for c in candidates if c in row.columns and np.isfinite(row[c]).all()]
    for column in columns:
        units = [meta[column].get("unit") for meta in (fields, own) if column in meta]
        if len(set(units)) > 1:
            raise ScoringError(
                f"{column} is in {units[0]} in the reference and in {units[1]} in the recording; "
                "extract the features of both with the same plugins."
            )
    if not columns:
        raise ScoringError(
            "The recording has none of the features of the reference; extract both with the same "
            "plugins, and compare recordings of the same kind of system."
        )
    # Features that some normal runs lack as well are not reported.
    usual = reference[list(candidates)].notna().all()
    absent = [column for column in candidates if column not in columns and usual[column]]
    if not absent:
        return columns, []
    reasons = json.loads(row[MISSING].iloc[0])
    why = list(dict.fromkeys(reasons.get(column, "not extracted") for column in absent))
    return columns, [
        f"{len(absent)} features of the reference count as usual, because this recording lacks "
        f"them: {join_first(absent)} ({join_first(why)})."
    ]


def join_first(words: Sequence[str]) -> str:
    """Return the first `LISTED` words as a comma-separated list."""
    return ", ".join([*words[:LISTED], *(["..."] if len(words) > LISTED else [])])


def _normal_runs(
    row: pd.DataFrame, reference: pd.DataFrame, columns: list[str], notes: list[str]
) -> pd.DataFrame:
    """Return the runs to compare with; append to `notes` why normal runs are left out."""
    normal = reference[~is_malicious(reference)]
    alike = same_kind(normal, columns)
    if not alike.all():
        notes.append(
            f"{np.sum(~alike)} normal runs of the reference are left out, because they come from "
            "another kind of system: they lack a whole family of features that this recording has."
        )
    own_block = normal["block"].isin(reference.loc[same_recording(reference, row), "block"])
    if own_block.any():
        notes.append("It is one of the reference runs, so all runs of its block are left out.")
    return normal[alike & ~own_block.to_numpy()]


def same_kind(table: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.bool_]:
    """Return a mask of the runs that have a value in each family of the compared features."""
    given = table[list(columns)].notna()
    families = [column.split(".", 1)[0] for column in columns]
    return np.asarray(given.T.groupby(families).any().all(), dtype=np.bool_)


def same_recording(reference: pd.DataFrame, row: pd.DataFrame) -> NDArray[np.bool_]:
    """Return a mask of the reference runs with exactly the features of this recording."""
    measured = [*feature_columns(reference), *signal_columns(reference)]
    columns = [column for column in measured if column in row.columns]
    theirs, own = reference[columns].to_numpy(), row[columns].to_numpy()
    same = (theirs == own) | (np.isnan(theirs) & np.isnan(own))
    return np.asarray(same.all(axis=1), dtype=np.bool_)
