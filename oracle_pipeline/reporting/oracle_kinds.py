"""The tables of the report that compare kinds of oracle."""

from dataclasses import replace

import pandas as pd

from oracle_pipeline.evaluation.oracle_kinds import KindsComparison
from oracle_pipeline.reporting.page_tables import PageColumn, PageTable, grid
from oracle_pipeline.reporting.report import Report

ORACLES, BY_MODE = "oracle_kinds", "oracle_kinds_by_mode"

_RATE = "at a false positive rate of 5%"
_ORACLES = (
    PageColumn("oracle", "oracle"),
    PageColumn("needs", "asks"),
    PageColumn("number of these", "written", spec=".0f"),
    PageColumn("processor time per run [s]", "seconds_a_run", spec=".3f"),
    PageColumn("AUC", "auc"),
    PageColumn("detection rate", "detection_rate", _RATE),
    PageColumn("realised false positives", "false_alarm_rate", _RATE),
    PageColumn("false positives on harmless changes", "false_alarm_rate_harmless", _RATE),
    PageColumn("note", "note"),
)


def with_kinds(report: Report, comparison: KindsComparison) -> Report:
    """Return the report on an evaluation, with the tables of the kinds of oracle added."""
    tables = {ORACLES: comparison.oracles, BY_MODE: comparison.by_mode}
    return replace(report, tables={**report.tables, **tables})


def tables_of_kinds(report: Report) -> dict[str, PageTable]:
    """Return the tables of the page by name; none if the kinds were not compared."""
    if ORACLES not in report.tables:
        return {}
    by_mode = report.tables[BY_MODE]
    names = list(dict.fromkeys(by_mode["oracle"])) if len(by_mode) else []
    columns = [PageColumn("mode", "mode"), PageColumn("label", "label"), PageColumn("runs", "runs")]
    columns += [PageColumn(name, name, "share called anomalous") for name in names]
    return {
        ORACLES: grid("Kinds of oracle on the same runs", report.tables[ORACLES], _ORACLES),
        BY_MODE: grid("Runs called anomalous by kind and mode", _side_by_side(by_mode), columns),
    }


def _side_by_side(by_mode: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each mode, with an estimate for each oracle."""
    if by_mode.empty:
        return by_mode
    joined = by_mode[["mode", "label", "runs"]].drop_duplicates().set_index("mode")
    for name, of in by_mode.groupby("oracle", sort=False):
        for end in ("", "_low", "_high"):
            joined[f"{name}{end}"] = of.set_index("mode")[f"called{end}"]
    return joined.reset_index()
