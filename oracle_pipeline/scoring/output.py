"""Verdicts on recordings as text for people and JSON for programs, and the exit code."""

import dataclasses
import json
from collections.abc import Iterator, Sequence

from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.scoring.verdict import Evidence, Judgement, Verdict

# The worst of a suite counts.
EXIT_CODES: dict[Judgement, int] = {
    "normal": 0,
    "anomalous": 1,
    "error": 2,
}  # the worst of a suite counts

HEADINGS = ("feature", "value", "usual (5-95 %)", "z", "window", "where")


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Return 0 if all are normal, 1 if one is anomalous, 2 if one could not be judged."""
    return max(EXIT_CODES[verdict.outcome] for verdict in verdicts)


def as_json(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return one JSON object: the worst outcome, and each verdict with its basis."""
    worst = exit_code(verdicts)
    document = {
        "outcome": next(outcome for outcome, code in EXIT_CODES.items() if code == worst),
        "false_alarm_rate": far,
        "notes": list(notes),
        "recordings": [dataclasses.asdict(verdict) for verdict in verdicts],
    }
    return json.dumps(document, indent=2, allow_nan=False)


def as_text(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return a paragraph for each verdict, then once the remarks that all of them share."""
    judged = [_remarks(verdict) for verdict in verdicts if verdict.outcome != "error"]
    shared = [remark for remark in judged[0] if all(remark in j for j in judged)] if judged else []
    lines = [line for verdict in verdicts for line in paragraph(verdict, shared)]
    if judged:
        over = f", adjusted for a suite of {len(judged)} (Benjamini-Hochberg)"
        lines += ["", f"Anomalous is p <= {far:g}{over if len(judged) > 1 else ''}."]
    return "\n".join([*lines, *shared, *notes])


def _remarks(verdict: Verdict) -> list[str]:
    """Return the basis of a verdict, then its notes."""
    basis = (
        f"Judged by {verdict.detector} on {verdict.features} features: {verdict.fit_runs} normal "
        f"runs fit it, {verdict.calibration_runs} of {verdict.calibration_blocks} other blocks "
        "calibrate it."
    )
    return [basis, *verdict.notes]


def paragraph(verdict: Verdict, shared: Sequence[str] = ()) -> Iterator[str]:
    """Yield the lines on one verdict, without the remarks that are shared by all."""
    if verdict.outcome == "error":
        yield f"COULD NOT JUDGE  {verdict.recording}: {verdict.error}"
        return
    anomalous = verdict.outcome == "anomalous"
    yield (
        f"{'ANOMALOUS' if anomalous else 'normal   '}  {verdict.recording}  "
        f"p = {verdict.suite_p_value:.3g} (alone {verdict.p_value:.3g}, by block "
        f"{verdict.p_value_by_block:.3g}), score {verdict.score:.3g}"
    )
    if anomalous:
        yield from _aligned([HEADINGS, *map(cells, verdict.evidence)])
        yield from (f"    {_summary(family)}" for family in verdict.families)
    yield from (f"    {remark}" for remark in _remarks(verdict) if remark not in shared)


def cells(evidence: Evidence) -> tuple[str, ...]:
    """Return one piece of evidence as the cells of a table below `HEADINGS`."""
    unit = "" if evidence.unit == "1" else f" {evidence.unit}"
    window = "" if evidence.window_start_s is None else f"from {evidence.window_start_s:g} s"
    return (
        evidence.feature,
        f"{evidence.value:.4g}{unit}",
        f"{evidence.usual_low:.4g} to {evidence.usual_high:.4g}",
        _z(evidence.z, capped=evidence.capped),
        window,
        evidence.where or "",
    )


def _summary(family: FamilyDeviation) -> str:
    """Return a sentence on the features of one family."""
    return (
        f"{family.family}: {family.unusual} of {family.compared} features outside their usual "
        f"range, {family.feature} farthest (z {_z(family.z, capped=family.capped)})"
    )


def _z(z: float, *, capped: bool) -> str:
    """Return a robust z, and whether it is only as large as z may be."""
    return f"{z:+.1f} (capped)" if capped else f"{z:+.1f}"


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        padded = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield f"    {'  '.join(padded)}".rstrip()
