"""The page on recordings that arrived, and the report's link to it."""

import re
from dataclasses import replace

import lxml.html
import pandas as pd
import pytest

from oracle_pipeline.reporting.arrivals_page import SHOWN, arrivals_page, summary
from oracle_pipeline.reporting.trend import trend
from oracle_pipeline.scoring.verdict import Verdict
from tests.oracle_pipeline.scoring.test_kept_verdicts import WHOLE, kept

HOSTILE = "<script>alert(1)</script>"


def rows(verdicts):
    """Return the table of verdicts, the oldest first."""
    return pd.DataFrame([each.row for each in verdicts], columns=list(kept("", WHOLE).row))


def page_of(verdicts):
    return arrivals_page(rows(verdicts), {each.key: each for each in verdicts}.__getitem__)


def test_a_page_without_recordings_has_a_note():
    assert "0 recordings." in page_of([])


def test_every_recording_has_its_verdict_and_evidence():
    broken = Verdict(HOSTILE, "error", error="no end")
    page = page_of([kept("c", Verdict("c", "normal")), kept("b", broken), kept("a", WHOLE)])
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
    tree = lxml.html.fromstring(page_of([*nights, unscored]))
    assert tree.xpath("count(//figure/img)") == 1
    assert trend(rows([*nights, unscored])) == trend(rows(nights[::-1]))
    assert trend(rows(nights)) != trend(
        rows([*nights[:2], replace(nights[2], judged_at=nights[1].judged_at)])
    )
    assert trend(rows([nights[0], unscored])) == b""  # one score has no trend


def test_of_many_recordings_the_newest_and_the_oddest_are_shown_and_no_other_is_read():
    many = [kept(f"k{n}", Verdict(f"k{n}", "normal", score=0.0)) for n in range(500)]
    many[7] = kept("k7", replace(WHOLE, recording="k7"))
    read = []

    def load(key):
        read.append(key)
        return many[int(key[1:])]

    tree = lxml.html.fromstring(arrivals_page(rows(many), load))
    assert read == [f"k{n}" for n in range(499, 499 - SHOWN, -1)] + ["k7"]
    assert "The 50 most unusual recordings and the 50 newest are listed." in tree.text_content()
    oddest, newest = ([row.text_content() for row in table.xpath("tbody/tr")]
                      for table in tree.xpath("//table")[:2])  # fmt: skip
    assert len(newest) == SHOWN
    assert ["k7" in row for row in oddest] == [True]


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        (["normal"], "1 recording: 1 normal."),
        (["normal", "anomalous", "normal"], "3 recordings: 1 anomalous, 2 normal."),
    ],
)
def test_the_summary_counts_the_worst_first(outcomes, words):
    assert summary(rows([kept("a", Verdict("a", outcome)) for outcome in outcomes])) == words
