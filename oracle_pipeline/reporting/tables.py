"""Tables of all pages: what `templates/tables.yaml` declares of a table, formatted cell by cell.

The macro ``table`` of ``templates/macros.html.j2`` draws them in a page, and `PageTable.lines` in a
terminal.
"""

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import yaml

from oracle_pipeline.bags.terminal import aligned_lines
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.scoring.output import HEADINGS, cells
from oracle_pipeline.scoring.verdict import Evidence

NO_FIGURE = "n/a"
_NEVER = "never"  # an infinite time
_NOTE = "note"  # a column of texts, which are listed once below the table
_LAYOUTS = Path(__file__).with_name("templates") / "tables.yaml"


class _PageCell(NamedTuple):
    """One cell of a table: its text and, smaller, its interval."""

    text: str
    interval: str = ""


class _PageColumn(NamedTuple):
    """One column of a table, below a group heading."""

    title: str
    name: str  # of the DataFrame's column
    group: str = ""
    spec: str = ""  # number format; by default two digits with an interval, else three


class PageTable(NamedTuple):
    """A table ready for the page."""

    caption: str
    groups: Sequence[tuple[str, int]]  # heading, columns below it
    columns: Sequence[_PageColumn]
    rows: Sequence[Sequence[_PageCell]]
    notes: Sequence[str] = ()  # the column of notes has their numbers
    links: Sequence[str] = ()  # of the first cell of each row

    def lines(self) -> Iterator[str]:
        """Yield the table as aligned lines."""
        cells = ([" ".join(filter(None, cell)) for cell in row] for row in self.rows)
        yield from aligned_lines([[column.title for column in self.columns], *cells], indent="    ")


def table(name: str, df: pd.DataFrame, links: Sequence[str] = ()) -> PageTable:
    """Return the declared table of that name, with those of its columns that have any value.

    Parameters
    ----------
    name : str
        In ``tables.yaml``.
    df : DataFrame
        An estimate has three columns (`Estimate.of_row`).
    links : sequence of str
        A link for the first cell of each row.
    """
    caption, columns = _layouts()[name]
    return _filled(caption, df, columns, links)


def plain_table(caption: str, df: pd.DataFrame) -> PageTable:
    """Return a table with all of its columns under their own names."""
    columns = [_PageColumn(str(name).replace("_", " "), str(name)) for name in df.columns]
    return _filled(caption, df, columns)


def evidence_table(caption: str, evidence: Iterable[Evidence]) -> PageTable:
    """Return pieces of evidence, one feature in each row."""
    return plain_table(caption, pd.DataFrame(map(cells, evidence), columns=list(HEADINGS)))


@functools.cache
def _layouts() -> dict[str, tuple[str, list[_PageColumn]]]:
    declared = yaml.safe_load(_LAYOUTS.read_text("utf-8"))
    return {
        name: (layout["caption"], [c for part in layout["columns"] for c in _columns(part)])
        for name, layout in declared.items()
        if not name.startswith(".")
    }


def _columns(declared: Mapping[str, Any], group: str = "") -> Iterator[_PageColumn]:
    for title, field in declared.items():
        if isinstance(field, dict):
            yield from _columns(field, title)
        else:
            name, spec = field if isinstance(field, list) else (field, "")
            yield _PageColumn(title, name, group, spec)


def _filled(
    caption: str, df: pd.DataFrame, columns: Sequence[_PageColumn], links: Sequence[str] = ()
) -> PageTable:
    shown = [column for column in columns if _has_values(df, column.name)]
    groups = [(name, len(list(members))) for name, members in groupby(shown, lambda c: c.group)]
    number: dict[str, str] = {}
    if any(column.name == _NOTE for column in shown):
        notes = dict.fromkeys(filter(None, df[_NOTE].fillna("")))
        number = {note: str(n) for n, note in enumerate(notes, start=1)}
        df = df.assign(**{_NOTE: df[_NOTE].map(number).fillna("")})
    rows = [[_cell(row, column) for column in shown] for _, row in df.iterrows()]
    return PageTable(caption, groups, shown, rows, list(number), links)


def _has_values(df: pd.DataFrame, name: str) -> bool:
    return name in df.columns and bool((df[name].notna() & (df[name] != "")).any())


def _cell(row: pd.Series, column: _PageColumn) -> _PageCell:
    value = row[column.name]
    if f"{column.name}_low" in row.index:
        text, _, interval = f"{Estimate.of_row(row, column.name):{column.spec}}".partition(" ")
        return _PageCell(*(part.replace("inf", _NEVER) for part in (text, interval)))
    if not isinstance(value, float):
        return _PageCell(str(value))
    return _PageCell(NO_FIGURE if pd.isna(value) else f"{value:{column.spec or '.3f'}}")
