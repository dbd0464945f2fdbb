"""Outcomes as JUnit XML, for a CI system."""

import re
from collections.abc import Sequence
from typing import Literal, NamedTuple
from xml.etree import ElementTree

from oracle_pipeline.scoring.output import cards, paragraph
from oracle_pipeline.scoring.sentences import headline
from oracle_pipeline.scoring.verdict import Verdict

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class TestCase(NamedTuple):
    """One test case; it has passed if it has neither a failure nor an error.

    The first line of the text is the message that a CI system shows in its lists.
    """

    name: str
    kind: Literal["", "failure", "error"] = ""
    text: str = ""


def as_junit(verdicts: Sequence[Verdict]) -> bytes:
    """Return JUnit XML with a test case for each recording; anomalous ones and breaches fail."""
    cases = [_test_case(verdict) for verdict in verdicts]
    return junit_document("oracle score", cases, reference=" ".join(cards(verdicts)))


def _test_case(verdict: Verdict) -> TestCase:
    if verdict.outcome == "normal":
        return TestCase(verdict.recording)
    failed = verdict.outcome in {"anomalous", "breach"}
    kind: Literal["failure", "error"] = "failure" if failed else "error"
    text = [headline(verdict), *paragraph(verdict, verbose=True)]
    return TestCase(verdict.recording, kind, "\n".join(text))


def junit_document(command: str, cases: Sequence[TestCase], **properties: str) -> bytes:
    """Return the JUnit XML of one command's test cases; `command` is such as ``oracle score``."""
    kinds = [case.kind for case in cases]
    suite = ElementTree.Element(
        "testsuite",
        name=command,
        tests=str(len(kinds)),
        failures=str(kinds.count("failure")),
        errors=str(kinds.count("error")),
    )
    given = {name: value for name, value in properties.items() if value}
    of_suite = ElementTree.SubElement(suite, "properties") if given else suite
    for name, value in given.items():
        ElementTree.SubElement(of_suite, "property", name=name, value=_xml_text(value))
    for case in cases:
        element = ElementTree.SubElement(
            suite, "testcase", classname=command.replace(" ", "."), name=_xml_text(case.name)
        )
        if case.kind:
            text = _xml_text(case.text)
            message = text.partition("\n")[0]
            ElementTree.SubElement(element, case.kind, message=message).text = text
    ElementTree.indent(suite)
    document: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def _xml_text(text: str) -> str:
    """Replace the characters that XML cannot hold."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
