"""Formats a table of features as text for the terminal."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence

import pandas as pd

from oracle_pipeline import datasets
from oracle_pipeline.bags.terminal import aligned_lines

_PLAIN_UNIT = "1"  # of a share, a ratio or a count


def as_text(table: pd.DataFrame, notes: Sequence[str] = ()) -> str:
    """Return the features of each robot of a recording, one per line.

    Parameters
    ----------
    table : DataFrame
        The features of a whole recording, a row for each robot; or those of its windows. Of windows
        the smallest value, the median and the largest are shown.
    notes : sequence of str
        What of the recording is missing, could not be read or was not used.
    """
    described = (
        line
        for name, rows in table.groupby("run_id", sort=False)
        for line in (*_features(str(name), rows), "")
    )
    return "\n".join([*described, *(f"Note: {note}" for note in notes)]).rstrip()


def _features(name: str, rows: pd.DataFrame) -> Iterator[str]:
    of_windows = datasets.WINDOW_START in rows
    units = {column: field["unit"] for column, field in datasets.field_metadata(rows).items()}
    columns = datasets.feature_columns(rows)
    computed = [column for column in columns if rows[column].notna().any()]
    windows = f" in {len(rows)} windows of 5 s" if of_windows else ""
    signals = len({column.rpartition(".")[0] for column in datasets.signal_columns(rows)})
    yield f"{name}: {len(computed)} of {len(columns)} features, {signals} signals{windows}"
    where = json.loads(rows[datasets.WHERE].iloc[0])
    lines: list[tuple[str, ...]]
    if of_windows:
        lines = [("feature", "smallest", "median", "largest", "unit")]
        for column in computed:
            values = rows[column]
            three = (f"{each:.4g}" for each in (values.min(), values.median(), values.max()))
            lines.append((column, *three, _unit(units[column])))
    else:
        lines = [("feature", "value", "unit", "where")]
        lines += [
            (column, f"{rows[column].iloc[0]:.4g}", _unit(units[column]), where.get(column, ""))
            for column in computed
        ]
    yield from aligned_lines(lines)
    reasons = json.loads(rows[datasets.MISSING].iloc[-1])
    absent = Counter(
        (column.partition(".")[0], reasons[column])
        for column in columns
        if column not in computed and column in reasons
    )
    if absent:
        yield "Could not be computed:"
        yield from aligned_lines(
            [(f"{family}.*", str(count), reason) for (family, reason), count in absent.items()],
            indent="    ",
        )


def _unit(unit: str) -> str:
    return "" if unit == _PLAIN_UNIT else unit
