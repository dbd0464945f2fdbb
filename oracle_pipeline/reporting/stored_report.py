"""A report: tables and a few facts, stored together in one folder."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from oracle_pipeline.bags import seals
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.scratch import replaced_folder
from oracle_pipeline.datasets import read_table, write_table
from oracle_pipeline.evaluation.estimate import Estimate

TABLE, TABLES, SUMMARY = "table.parquet", "tables", "summary.json"
_SEAL = "seal"  # a key of the summary's file


class ReportError(OracleError):
    """A stored report cannot be read."""


@dataclass(frozen=True, eq=False, slots=True)
class Report:
    """The content of one report."""

    table: pd.DataFrame
    summary: Mapping[str, float | int | str]  # JSON values only, no NaN
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)  # further ones, by name

    def save(self, directory: Path) -> None:
        """Replace a folder by this report.

        The report is written to a sibling path and renamed, so that no reader sees half of it.
        """
        with replaced_folder(directory) as new:
            write_table(self.table, new / TABLE)
            for name, table in self.tables.items():
                write_table(table, new / TABLES / f"{name}.parquet")
            document = {**self.summary, _SEAL: seals.BLANK}
            text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
            summary = bytearray(text.encode())
            seals.seal(summary)
            (new / SUMMARY).write_bytes(summary)

    @classmethod
    def load(cls, directory: Path) -> "Report":
        """Read a report back.

        Raises
        ------
        ReportError
            The folder has no complete report, or its summary was changed.
        """
        try:
            content = (directory / SUMMARY).read_bytes()
            summary = json.loads(content.decode())
        except (FileNotFoundError, ValueError) as error:
            raise ReportError(
                f"{directory} has no report ({error}); materialize it again."
            ) from error
        if seals.check(content) == "wrong":
            raise ReportError(f"{directory / SUMMARY} is damaged; materialize the report again.")
        summary.pop(_SEAL, None)  # a report of an older release has none
        tables = {
            path.stem: read_table(path) for path in sorted((directory / TABLES).glob("*.parquet"))
        }
        return cls(read_table(directory / TABLE), summary, tables)


def facts(name: str, estimate: Estimate) -> dict[str, float | str]:
    """Return an estimate for a summary: its text, and its three numbers if it has them."""
    numbers = {} if np.isnan(estimate.value) else estimate.columns(name)
    return {f"{name}_text": str(estimate), **numbers}
