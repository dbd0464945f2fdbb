"""Verdicts on recordings as JUnit XML, for a CI system."""

import re
from collections.abc import Sequence
from xml.etree import ElementTree

from oracle_pipeline.scoring.output import paragraph
from oracle_pipeline.scoring.verdict import Verdict

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def as_junit(verdicts: Sequence[Verdict]) -> bytes:
    """Return JUnit XML: a test case for each recording, anomalous ones are its failures."""
    outcomes = [verdict.outcome for verdict in verdicts]
    suite = ElementTree.Element(
        "testsuite",
        name="oracle score",
        tests=str(len(outcomes)),
        failures=str(outcomes.count("anomalous")),
        errors=str(outcomes.count("error") + outcomes.count("unsupported")),
    )
    for verdict in verdicts:
        name = _xml_text(verdict.recording)
        case = ElementTree.SubElement(suite, "testcase", classname="oracle.score", name=name)
        if verdict.outcome == "normal":
            continue
        what = "failure" if verdict.outcome == "anomalous" else "error"
        text = _xml_text("\n".join(paragraph(verdict)))
        ElementTree.SubElement(case, what, message=text.partition("\n")[0]).text = text
    ElementTree.indent(suite)
    document: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def _xml_text(text: str) -> str:
    """Replace the characters that XML cannot hold."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
