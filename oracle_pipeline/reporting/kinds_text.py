"""Formats the comparison of several kinds of oracle as text and JSON."""

import json
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from oracle_pipeline.bags.terminal import aligned_lines

if TYPE_CHECKING:
    from oracle_pipeline.evaluation.oracle_kinds import KindsComparison

_FEW = 20  # most recordings without a label to show p-values of


def as_text(comparison: "KindsComparison", far: float) -> str:
    """Return the tables of oracles, of modes, and of recordings without a label."""
    oracles, by_mode = comparison.oracles, comparison.by_mode
    head = ("oracle", "detects", "95 % interval", "false positives", "95 % interval", "needs",
            "ms per run")  # fmt: skip
    rows: list[tuple[str, ...]] = [head]
    for _, row in oracles.iterrows():
        rows.append(
            (
                str(row["oracle"]),
                *_estimate(row, "detection_rate"),
                *_estimate(row, "false_alarm_rate"),
                _needed_input(row),
                _number(1e3 * row.get("seconds_a_run", np.nan), ".1f"),
            )
        )
    lines = [f"Nominal false positive rate: {far:g}, sessions held out", ""]
    lines += aligned_lines(rows, indent="    ")
    names = list(dict.fromkeys(by_mode["oracle"])) if len(by_mode) else []
    if names:
        called = by_mode.pivot(index="mode", columns="oracle", values="called")
        rows = [("share called anomalous", "label", "runs", *names)]
        for mode, of in by_mode.groupby("mode", sort=False):
            shares = (_number(float(called[name][mode]), ".2f") or "n/a" for name in names)
            rows.append((str(mode), of["label"].iloc[0], str(of["runs"].iloc[0]), *shares))
        lines += ["", *aligned_lines(rows, indent="    ")]
    unknown = comparison.p[comparison.p["label"] == "unknown"]
    if len(unknown):
        rows = [("p-value", *names)]
        for _, row in unknown.head(_FEW).iterrows():
            rows.append((str(row["run_id"]), *(f"{row[name]:.3f}" for name in names)))
        lines += ["", *aligned_lines(rows, indent="    ")]
    notes = _notes(oracles)
    return "\n".join([*lines, *([""] if notes else []), *notes])


def as_json(comparison: "KindsComparison", far: float) -> str:
    """Return one JSON object with the three tables; unknown values are null."""
    tables = {"oracles": comparison.oracles, "by_mode": comparison.by_mode, "runs": comparison.p}
    document = {
        "far": far,
        **{name: json.loads(table.to_json(orient="records")) for name, table in tables.items()},
    }
    return json.dumps(document, indent=2, allow_nan=False)


def _estimate(row: pd.Series, name: str) -> tuple[str, str]:
    value, low, high = (row.get(f"{name}{end}", np.nan) for end in ("", "_low", "_high"))
    if pd.isna(value):
        return "n/a", ""
    return f"{value:.3f}", f"{low:.3f} to {high:.3f}"


def _notes(oracles: pd.DataFrame) -> list[str]:
    """Return each note once, behind the names of the oracles that it is about."""
    about: dict[str, list[str]] = {}
    for _, row in oracles.iterrows():
        if isinstance(note := row.get("note"), str) and note:
            about.setdefault(note, []).append(str(row["oracle"]))
    return [f"{', '.join(names)}: {note}" for note, names in about.items()]


def _needed_input(row: pd.Series) -> str:
    written = row.get("written", np.nan)
    return f"{written:.0f} {row['asks']}" if written > 0 else str(row["asks"])


def _number(value: float, spec: str) -> str:
    return "" if pd.isna(value) else format(value, spec)
