"""Which features a recording shares with a reference, and which of its runs it resembles."""

import json
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline import datasets
from oracle_pipeline.bags.terminal import join_first
from oracle_pipeline.features.signals.fields import sequences
from oracle_pipeline.scoring.verdict import ScoringError

_PRESENT = ".missing"  # ends the column of every number that a recording has


def shared_features(
    row: pd.DataFrame, reference: pd.DataFrame, candidates: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Return the features that a recording and the reference share, and a note on the others.

    Raises
    ------
    ScoringError
        They share no feature, or a feature has different units.
    """
    fields, own = datasets.field_metadata(reference), datasets.field_metadata(row)
    values = row.reindex(columns=list(candidates)).to_numpy(dtype=np.float64)
    columns = [c for c, value in zip(candidates, values.T, strict=True) if np.isfinite(value).all()]
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
    reasons = json.loads(row[datasets.MISSING].iloc[0])
    why = list(dict.fromkeys(reasons.get(column, "not extracted") for column in absent))
    return columns, [
        f"{len(absent)} features of the reference count as usual, because this recording lacks "
        f"them: {join_first(absent)} ({join_first(why)})."
    ]


def given_numbers(df: pd.DataFrame) -> pd.DataFrame:
    """Return which numbers of their messages runs have: a column of truth values for each.

    Those in sequences of messages, such as detected objects, are left out: these may be empty.
    Differences of two numbers are, too.
    """
    given = (c for c in datasets.signal_columns(df) if c.endswith(_PRESENT))
    columns = [column for column in given if datasets.MINUS not in column]
    may_be_empty = sequences(column.removesuffix(_PRESENT) for column in columns)
    columns = [column for column in columns if not column.startswith(may_be_empty)]
    return df[columns].notna().rename(columns=lambda column: column.removesuffix(_PRESENT))


def lacking_numbers(own: pd.DataFrame, usual: pd.DataFrame) -> dict[str, str]:
    """Return the numbers that all usual runs have, and not all others have, by topic.

    Topics without any number are left out.

    Parameters
    ----------
    own, usual : DataFrame
        From `given_numbers`.
    """
    has, wanted = (set(each.columns[each.all()]) for each in (own, usual))
    lacking: dict[str, list[str]] = {}
    of_topic = Counter(map(datasets.topic_of_signal, has))
    for number in sorted(wanted - has):
        topic = datasets.topic_of_signal(number)
        # One is the time between messages. The rate of a counter stands for its level.
        if of_topic[topic] > 1 and f"{number}.rate" not in has:
            lacking.setdefault(topic, []).append(number.rpartition("/")[2])
    return {topic: join_first(names) for topic, names in lacking.items()}


def same_kind(table: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.bool_]:
    """Return a mask of the runs that have a value in each family of the compared features."""
    given = table[list(columns)].notna()
    families = [column.split(".", 1)[0] for column in columns]
    return np.asarray(given.T.groupby(families).any().all(), dtype=np.bool_)


def same_recording(reference: pd.DataFrame, row: pd.DataFrame) -> NDArray[np.bool_]:
    """Return a mask of the reference runs with exactly the features of this recording."""
    columns = [column for column in reference.columns.tolist() if "." in column and column in row]
    same = np.ones(len(reference), dtype=np.bool_)
    for some in (columns[:: len(columns) // 8 + 1], columns):
        if same.any():  # seldom are rows equal in some columns, and not in all
            theirs, own = reference[some].to_numpy()[same], row[some].to_numpy()
            same[same] = ((theirs == own) | (np.isnan(theirs) & np.isnan(own))).all(axis=1)
    return same
