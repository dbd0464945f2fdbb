"""Dagster metadata for tables, pictures and reports.

Metadata accept plain Python values only: no NumPy scalars, no NaN.
"""

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import dagster as dg

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.reporting.stored_report import Report

MAX_PNG_BYTES = 100_000  # pictures live in the event log, which every page load reads
MAX_ROWS = 40

Metadata = dict[str, dg.MetadataValue]


_KEYS = {
    "run_id": "the run: mode|number",
    "mode": "the experiment; foreign: a recording from elsewhere",
    "label": "normal, malicious (attacked), control or unknown",
    "block": "runs of a block have the same start and goals; -1: none",
    "session": "the day in the laboratory, which blocks share; -1: none",
    "world": "the place of the run, such as an arena",
    "window_start_s": "start of the window in the recording [s]",
    "where": "JSON: topic, pair or edge at which each feature was attained",
    "missing": "JSON: why a feature has no value",
}


def png(picture: bytes) -> dg.MetadataValue:
    """Return a picture that is shown inline."""
    return dg.MetadataValue.md(
        f"![](data:image/png;base64,{base64.b64encode(picture).decode('ascii')})"
    )


def table(df: "pd.DataFrame") -> dg.TableMetadataValue:
    """Return the first rows of a table: numbers to four digits, estimates with their intervals."""
    bounds = {f"{name}_{end}" for name in df.columns for end in ("low", "high")}
    shown = [str(name) for name in df.columns if name not in bounds]
    records = [
        dg.TableRecord({name: _cell(row, name) for name in shown})
        for _, row in df.head(MAX_ROWS).iterrows()
    ]
    return dg.MetadataValue.table(
        records, schema=dg.TableSchema([dg.TableColumn(name, "string") for name in shown])
    )


def _cell(row: "pd.Series", name: str) -> str:
    from oracle_pipeline.evaluation.estimate import Estimate

    value = row[name]
    if f"{name}_low" in row.index:
        return str(Estimate.of_row(row, name))
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4g}"
    return str(value)


def columns(df: "pd.DataFrame") -> dg.TableSchema:
    """Return a feature table's columns with unit and meaning, for the Columns tab.

    Signals are one column, as in the file.
    """
    from oracle_pipeline.datasets import field_metadata, signal_columns

    fields, signals = field_metadata(df), signal_columns(df)
    shown = [
        dg.TableColumn(
            str(name),
            str(dtype),
            description=_KEYS.get(str(name)) or _meaning(fields.get(str(name), {})),
        )
        for name, dtype in df.drop(columns=signals).dtypes.items()
    ]
    if signals:
        about = f"{len(signals)} statistics of signals: name, declaration and value"
        shown.append(dg.TableColumn("signals", "list", description=about))
    return dg.TableSchema(shown)


def columns_of(place: Path) -> dg.TableSchema:
    """Return the columns of a feature table, by its path."""
    from oracle_pipeline.datasets import read_table

    return columns(read_table(place))


def _meaning(field: Mapping[str, str]) -> str | None:
    if not field:
        return None
    return f"{field.get('description', '')} [{field.get('unit', '?')}]".strip()


def facts(summary: Mapping[str, float | int | str | bytes]) -> Metadata:
    """Return facts and pictures as metadata; numbers stay numbers, so that the UI plots them.

    An empty text is left out.
    """
    return {
        name: png(value) if isinstance(value, bytes)
        else dg.MetadataValue.text(value) if isinstance(value, str)
        else dg.MetadataValue.int(value) if isinstance(value, int)
        else dg.MetadataValue.float(value)
        for name, value in summary.items()
        if value != ""
    }  # fmt: skip


def picture(data: bytes) -> Metadata:
    """Return a picture if it is small enough for the event log."""
    return {"picture": png(data)} if 0 < len(data) < MAX_PNG_BYTES else {}


def report(result: "Report") -> Metadata:
    """Return a report's facts and its table."""
    return {
        **facts(result.summary),
        "table": table(result.table),
        "dagster/row_count": dg.MetadataValue.int(len(result.table)),
        "dagster/column_schema": dg.MetadataValue.table_schema(columns(result.table)),
    }
