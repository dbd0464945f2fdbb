"""The comparison of several kinds of oracle: text and JSON."""

import json

import numpy as np
import pandas as pd

from oracle_pipeline.bags.terminal import aligned_lines
from oracle_pipeline.evaluation.kinds_comparison import KindsComparison
from oracle_pipeline.reporting.tables import PageTable, plain_table, table

_FEW = 20  # most recordings without a label to show p-values of; JSON has all


def as_text(comparison: KindsComparison, far: float) -> str:
    """Return the tables of oracles, of modes, and of recordings without a label."""
    oracles = comparison.oracles
    shown = oracles.assign(ms_a_run=1e3 * oracles.get("seconds_a_run", np.nan))
    sections = [[f"Nominal false positive rate: {far:g}, sessions held out"]]
    sections.append([*table("kinds_in_terminal", shown).lines()])
    if "detection_rate" in oracles:  # there are enough runs for the rate
        sections.append([*_called_by_mode(comparison.p, far).lines()])
    sections.append(_p_of_unknown(comparison.p))
    if "note" in oracles:
        notes = oracles[oracles["note"].fillna("") != ""].groupby("note", sort=False)["oracle"]
        sections.append([f"{', '.join(names)}: {note}" for note, names in notes])
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def _called_by_mode(p: pd.DataFrame, far: float) -> PageTable:
    """Return the share of the runs of each mode that each oracle calls anomalous."""
    known = p[p["label"] != "unknown"].set_index(["label", "mode"]).drop(columns="run_id")
    shares = (known <= far).groupby(level=[0, 1]).mean().reset_index()
    return plain_table("Share called anomalous", shares)


def _p_of_unknown(p: pd.DataFrame) -> list[str]:
    """Return the p-values of recordings without a label as lines."""
    unknown = p[p["label"] == "unknown"].drop(columns=["mode", "label"])
    shown = unknown.head(_FEW).itertuples(index=False)
    rows = [(row[0], *map("{:.3f}".format, row[1:])) for row in shown]
    head = ("p-value", *unknown.columns[1:])
    more = len(unknown) - len(rows)
    return [
        *(aligned_lines([head, *rows], indent="    ") if rows else ()),
        *([f"    {more} more recordings; --format json lists all."] if more else ()),
    ]


def as_json(comparison: KindsComparison, far: float) -> str:
    """Return one JSON object with both tables; unknown values are null."""
    tables = {"oracles": comparison.oracles, "runs": comparison.p}
    document = {
        "far": far,
        **{name: json.loads(table.to_json(orient="records")) for name, table in tables.items()},
    }
    return json.dumps(document, indent=2, allow_nan=False)
