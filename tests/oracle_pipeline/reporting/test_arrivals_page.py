"""The page on recordings that arrived, and the report's link to it."""

import re
from dataclasses import replace

import lxml.html
import pytest

from oracle_pipeline.reporting.arrivals_page import arrivals_page, summary
from oracle_pipeline.reporting.trend import trend
from oracle_pipeline.scoring.verdict import Verdict
from tests.oracle_pipeline.scoring.test_kept_verdicts import WHOLE, kept

HOSTILE = "<script>alert(1)</script>"


def test_a_page_without_recordings_has_a_note():
    assert "0 recordings." in arrivals_page([])


def test_every_recording_has_its_verdict_and_evidence():
    broken = Verdict(HOSTILE, "error", error="no end")
    page = arrivals_page([kept("a", WHOLE), kept("b", broken), kept("c", Verdict("c", "normal"))])
    assert HOSTILE not in page
    tree = lxml.html.fromstring(page)
    rows = [row.text_content() for row in tree.xpath("(//table)[1]/tbody/tr")]
    assert len(rows) == 3
    assert "anomalous" in rows[0]
    assert "could not be judged" in rows[1]
    assert "scan.noise" in page
    assert "Topic /scan is gone." in page
    ids = set(tree.xpath("//@id"))
    assert {link.removeprefix("#") for link in tree.xpath("//a/@href") if link[0] == "#"} <= ids
    assert not re.search(r"https?://", page)


def test_the_trend_has_every_scored_recording_at_its_time():
    nights = [
        kept(f"n{day}", replace(WHOLE, score=score), f"2026-11-0{day}T02:00:00+00:00")
        for day, score in ((1, 0.0), (2, 0.5), (3, 40.0))
    ]
    unscored = kept("broken", Verdict("broken", "error", error="no end"))
    tree = lxml.html.fromstring(arrivals_page([*nights, unscored]))
    assert tree.xpath("count(//figure/img)") == 1
    assert trend([*nights, unscored]) == trend(nights[::-1])
    assert trend(nights) != trend([*nights[:2], replace(nights[2], judged_at=nights[1].judged_at)])
    assert trend([nights[0], unscored]) == b""  # one score has no trend


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        (["normal"], "1 recording: 1 normal."),
        (["normal", "anomalous", "normal"], "3 recordings: 1 anomalous, 2 normal."),
    ],
)
def test_the_summary_counts_the_worst_first(outcomes, words):
    assert summary([kept("a", Verdict("a", outcome)) for outcome in outcomes]) == words
