"""The tables of features, as columns and as DataFrames.

pandas takes longer to import than a short recording takes to read, so printing avoids it.
"""

import math
from collections import ChainMap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.datasets import MISSING, Fields

if TYPE_CHECKING:
    import pandas as pd


class FeatureTables(NamedTuple):
    """The features of one recording; ``attrs["fields"]`` describes the columns."""

    run: "pd.DataFrame"  # one row
    windows: "pd.DataFrame"  # one row for each window, by start

    @property
    def notes(self) -> tuple[str, ...]:
        """Parts of the recording that are missing or were not used; none of a stored row."""
        return tuple(self.run.attrs.get("notes", ()))


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of one length, by name, and the metadata of each feature."""

    columns: dict[str, Any]  # numbers as float64, others as lists
    fields: dict[str, dict[str, str]]

    def __len__(self) -> int:
        return len(self.columns[MISSING])

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield each row by column."""
        values = [
            column.tolist() if isinstance(column, np.ndarray) else column
            for column in self.columns.values()
        ]
        for row in zip(*values, strict=True):
            yield dict(zip(self.columns, row, strict=True))

    def frame(self) -> "pd.DataFrame":
        """Return the table as a DataFrame."""
        import pandas as pd

        frame = pd.DataFrame(self.columns)
        frame.attrs["fields"] = Fields(self.fields)
        return frame


class RecordingFeatures(NamedTuple):
    """The features of one recording, as columns."""

    run: Table  # one row for each robot
    windows: Table  # one row for each window, by robot and start
    notes: tuple[str, ...]  # parts that are missing, could not be read or were not used

    def frames(self) -> FeatureTables:
        """Return the tables as DataFrames."""
        tables = FeatureTables(self.run.frame(), self.windows.frame())
        tables.run.attrs["notes"] = list(self.notes)
        return tables

    def among_others(self, path: Path, number: int) -> Self:
        """Return the tables of one of several recordings: named by path, and a block of its own."""
        for table in (self.run, self.windows):
            columns = table.columns
            columns["run_id"] = [printable(str(path.parent / name)) for name in columns["run_id"]]
            columns["block"] = [-1 - number if each == -1 else each for each in columns["block"]]
        return self._replace(notes=tuple(f"{path}: {note}" for note in self.notes))


def together(robots: Sequence[RecordingFeatures]) -> RecordingFeatures:
    """Join the tables of robots or recordings: a row for each robot, by ``run_id``."""
    if len(robots) == 1:
        return robots[0]
    notes = dict.fromkeys(note for measured in robots for note in measured.notes)
    return RecordingFeatures(
        _below([measured.run for measured in robots]),
        _below([measured.windows for measured in robots]),
        tuple(notes),
    )


def _below(tables: Sequence[Table]) -> Table:
    """Concatenate tables; a feature that a table lacks is NaN in its rows."""
    names = dict.fromkeys(name for table in tables for name in table.columns)
    columns: dict[str, Any] = {}
    for name in names:
        parts = [table.columns.get(name, np.full(len(table), math.nan)) for table in tables]
        if all(isinstance(part, np.ndarray) for part in parts):
            columns[name] = np.concatenate(parts)
        else:
            columns[name] = [value for part in parts for value in part]
    return Table(columns, dict(ChainMap(*[table.fields for table in tables])))
