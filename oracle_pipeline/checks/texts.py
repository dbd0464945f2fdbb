"""Faults as text, JSON, JUnit and a page."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from oracle_pipeline.bags.terminal import count_of
from oracle_pipeline.checks.topic import Fault
from oracle_pipeline.datasets import replacing
from oracle_pipeline.reporting.tables import PageTable, plain_table
from oracle_pipeline.reporting.templating import template
from oracle_pipeline.scoring.junit import TestCase, junit_document

CLEAN = "no fault found"


class Checked(NamedTuple):
    """The faults of one recording, or why it could not be checked."""

    recording: str
    faults: Sequence[Fault] = ()
    error: str = ""

    @property
    def exit_code(self) -> int:
        """0 without faults, 1 with faults, 2 if it could not be read."""
        return 2 if self.error else int(bool(self.faults))


def exit_code(results: Sequence[Checked]) -> int:
    """Return the worst exit code."""
    return max(checked.exit_code for checked in results)


def as_text(results: Sequence[Checked]) -> str:
    """Return the faults of each recording, and a last line that counts them."""
    lines = []
    for checked in results:
        lines.append(f"{checked.recording}: {_summary(checked)}")
        if checked.faults:
            lines += _table(checked).lines()
    faulty = sum(bool(checked.faults) for checked in results)
    unread = sum(bool(checked.error) for checked in results)
    clean = len(results) - faulty - unread
    return "\n".join([*lines, f"{faulty} with faults, {clean} without, {unread} not checked"])


def as_json(results: Sequence[Checked]) -> str:
    """Return one JSON object: the worst exit code, and the faults of each recording."""
    document = {
        "exit_code": exit_code(results),
        "recordings": [
            {
                "recording": checked.recording,
                "error": checked.error or None,
                "faults": [fault._asdict() for fault in checked.faults],
            }
            for checked in results
        ],
    }
    return json.dumps(document, indent=2)


def as_junit(results: Sequence[Checked]) -> bytes:
    """Return JUnit XML with a test case for each recording; those with faults fail."""
    return junit_document("oracle check", [_test_case(checked) for checked in results])


def write_page(path: Path, results: Sequence[Checked]) -> None:
    """Write one self-contained HTML page with a table for each recording."""
    page = template("checks.html.j2").render(
        results=results,
        summary=_summary,
        faults_table=_table,
        last=as_text(results).split("\n")[-1],
    )
    with replacing(path) as sink:
        sink.write(page.encode())


def _summary(checked: Checked) -> str:
    if checked.error:
        return f"could not be checked: {checked.error}"
    return count_of(len(checked.faults), "fault") if checked.faults else CLEAN


def _test_case(checked: Checked) -> TestCase:
    if checked.error:
        return TestCase(checked.recording, "error", checked.error)
    text = "\n".join(f"{fault.topic or 'all topics'}: {fault.text}" for fault in checked.faults)
    return TestCase(checked.recording, "failure" if text else "", text)


def _table(checked: Checked) -> PageTable:
    rows = [
        {
            "at": f"{fault.start_s:.2f} s",
            "check": fault.check.replace("_", " "),
            "topic": fault.topic or "all topics",
            "what": fault.text,
            "places": str(fault.places),
        }
        for fault in checked.faults
    ]
    return plain_table(f"Faults of {checked.recording}", pd.DataFrame(rows))
