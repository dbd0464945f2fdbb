"""Verdicts on recordings, shown to a person, a program or a CI system."""

import dataclasses
import json
import re
from collections.abc import Iterator, Sequence
from xml.etree import ElementTree

from oracle_pipeline.scoring import Evidence, Verdict

EXIT_CODES = {"pass": 0, "anomalous": 1, "error": 2}  # the worst of a suite counts

HEADINGS = ("feature", "value", "usual (5-95 %)", "z", "window", "where")
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Return 0 if all pass, 1 if one is anomalous, 2 if one could not be judged."""
    return max(EXIT_CODES[verdict.outcome] for verdict in verdicts)


def as_json(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return one JSON object: the worst outcome, and each verdict with all that it rests on."""
    worst = exit_code(verdicts)
    document = {
        "outcome": next(outcome for outcome, code in EXIT_CODES.items() if code == worst),
        "false_alarm_rate": far,
        "notes": list(notes),
        "recordings": [dataclasses.asdict(verdict) for verdict in verdicts],
    }
    return json.dumps(document, indent=2, allow_nan=False)


def as_text(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return a paragraph for each verdict, then what is true of all of them, once."""
    judged = [_remarks(verdict) for verdict in verdicts if verdict.outcome != "error"]
    shared = [remark for remark in judged[0] if all(remark in j for j in judged)] if judged else []
    lines = [line for verdict in verdicts for line in _paragraph(verdict, shared)]
    if judged:
        over = f", adjusted for a suite of {len(judged)} (Benjamini-Hochberg)"
        lines += ["", f"Anomalous is p <= {far:g}{over if len(judged) > 1 else ''}."]
    return "\n".join([*lines, *shared, *notes])


def _remarks(verdict: Verdict) -> list[str]:
    """Return what a judged verdict rests on, then its notes."""
    basis = (
        f"Judged by {verdict.detector} on {verdict.features} features: {verdict.fit_runs} right "
        f"runs fit it, {verdict.calibration_runs} of {verdict.calibration_blocks} other blocks "
        "calibrate it."
    )
    return [basis, *verdict.notes]


def _paragraph(verdict: Verdict, shared: Sequence[str]) -> Iterator[str]:
    if verdict.outcome == "error":
        yield f"COULD NOT JUDGE  {verdict.recording}: {verdict.error}"
        return
    anomalous = verdict.outcome == "anomalous"
    yield (
        f"{'ANOMALOUS' if anomalous else 'pass     '}  {verdict.recording}  "
        f"p = {verdict.suite_p_value:.3g} (alone {verdict.p_value:.3g}, by block "
        f"{verdict.p_value_by_block:.3g}), score {verdict.score:.3g}"
    )
    if anomalous:
        yield from _aligned([HEADINGS, *map(cells, verdict.evidence)])
    yield from (f"    {remark}" for remark in _remarks(verdict) if remark not in shared)


def cells(evidence: Evidence) -> tuple[str, ...]:
    """Return one line of what gave a recording away, below `HEADINGS`."""
    unit = "" if evidence.unit == "1" else f" {evidence.unit}"
    window = "" if evidence.window_start_s is None else f"from {evidence.window_start_s:g} s"
    return (
        evidence.feature,
        f"{evidence.value:.4g}{unit}",
        f"{evidence.usual_low:.4g} to {evidence.usual_high:.4g}",
        f"{evidence.z:+.1f}",
        window,
        evidence.where or "",
    )


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        padded = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield f"    {'  '.join(padded)}".rstrip()


def as_junit(verdicts: Sequence[Verdict]) -> bytes:
    """Return JUnit XML: a test case for each recording, anomalous ones are its failures."""
    outcomes = [verdict.outcome for verdict in verdicts]
    suite = ElementTree.Element(
        "testsuite",
        name="oracle score",
        tests=str(len(outcomes)),
        failures=str(outcomes.count("anomalous")),
        errors=str(outcomes.count("error")),
    )
    for verdict in verdicts:
        name = _xml_text(verdict.recording)
        case = ElementTree.SubElement(suite, "testcase", classname="oracle.score", name=name)
        if verdict.outcome == "pass":
            continue
        what = "failure" if verdict.outcome == "anomalous" else "error"
        text = _xml_text("\n".join(_paragraph(verdict, ())))
        ElementTree.SubElement(case, what, message=text.partition("\n")[0]).text = text
    ElementTree.indent(suite)
    document: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def _xml_text(text: str) -> str:
    """Replace the characters that XML cannot hold."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
