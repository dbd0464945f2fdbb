"""The page of `oracle score --page` shows every verdict, and escapes the recordings' texts."""

import base64
import re
from datetime import date
from html import unescape
from xml.etree import ElementTree

import pytest

from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.features import build_manager
from oracle_pipeline.replay.picture import picture
from oracle_pipeline.reporting import verdict_page
from oracle_pipeline.reporting.badge import as_badge
from oracle_pipeline.scoring.isolation import Limits
from oracle_pipeline.scoring.output import MOST_BREACHES
from oracle_pipeline.scoring.verdict import Evidence, Verdict
from tests.recorded_runs import linked

pytestmark = pytest.mark.slow

FEATURE = "redundancy.scan_contradicted"
HOSTILE = "<script>alert(1)</script>\x1b[2J"


def anomalous(recording, **more):
    evidence = (Evidence(FEATURE, 31.0, False, 0.06, "1", 0.0, 0.01, "/scan against /odd", 5.0),)
    families = (FamilyDeviation("redundancy", 1, 5, FEATURE, 31.0, False),)
    return Verdict(
        str(recording), "anomalous", p_value=0.05, suite_p_value=0.05, score=9.0, features=170,
        normal_runs=19, normal_blocks=19, evidence=evidence, families=families, **more,
    )  # fmt: skip


@pytest.fixture
def page(tmp_path):
    def write(*verdicts, notes=()):
        place = tmp_path / "page.html"
        verdict_page.write(place, verdicts, 0.05, notes, build_manager(), Limits(), picture)
        return place.read_text("utf-8")

    return write


def test_a_verdict_stands_beside_the_picture_and_the_evidence(recorded_run, page):
    html = unescape(page(anomalous(recorded_run("fake_object").path)))
    (png,) = re.findall(r'<img src="data:image/png;base64,([^"]+)"', html)
    assert base64.b64decode(png).startswith(b"\x89PNG")
    assert "Of 19 normal recordings, none is at least as unusual: p = 0.05." in html
    assert build_manager().features()[FEATURE].description in html
    assert "redundancy: 1 of 5 features outside their usual range" in html


def test_a_recording_that_cannot_be_drawn_keeps_its_verdict_with_a_note(tmp_path, page):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag")
    html = page(anomalous(broken), Verdict(str(broken), "error", error="It is no bag."))
    assert "<img" not in html
    assert f"It is not drawn: {broken}" in html
    assert html.index("Anomalous") < html.index("Could not be judged") < html.index("It is no bag.")


def test_breaches_come_first_and_many_of_them_leave_room_for_the_picture(recorded_run, page):
    told = [f"Topic /topic{number} is gone." for number in range(MOST_BREACHES + 3)]
    html = page(anomalous(recorded_run("fake_object").path, contract=tuple(told)))
    above, below = html.split("<img")
    assert [each in above for each in told] == [True] * MOST_BREACHES + [False] * 3
    assert above.index(told[0]) < above.index("Of 19 normal recordings")
    assert "and 3 more differences from the contract; the remarks list all." in above
    assert all(each in below for each in told[MOST_BREACHES:])


def test_names_and_texts_of_a_recording_are_escaped(recorded_run, tmp_path, page):
    run = linked(recorded_run("fake_object"), tmp_path / "<script>")
    html = page(anomalous(run.path, contract=(HOSTILE,)), notes=(HOSTILE,))
    assert "<script" not in html
    assert "\x1b" not in html
    assert html.count("&lt;script&gt;") >= 3
    assert "default-src &#39;none&#39;" in html or "default-src 'none'" in html


@pytest.mark.parametrize(
    ("verdicts", "told", "colour"),
    [
        ([Verdict("a", "normal", suite_p_value=0.4)], "1 normal · p 0.4 · 2026-01-31", "#1b6a39"),
        ([anomalous("a"), anomalous("b")], "2 anomalous · p 0.05 · 2026-01-31", "#a3281b"),
        ([Verdict("a", "error", error="<gone>")], "1 not judged · 2026-01-31", "#7a5200"),
    ],
)
def test_a_badge_has_outcome_lowest_p_and_date(verdicts, told, colour):
    svg = ElementTree.fromstring(as_badge(verdicts, date(2026, 1, 31)))  # noqa: S314 -- ours
    assert svg.get("aria-label") == f"behaviour: {told}"
    assert colour in {part.get("fill") for part in svg}


def test_the_page_loads_nothing(recorded_run, page):
    html = page(anomalous(recorded_run("fake_object").path))
    assert re.findall(r'(?:src|href)="(?!data:)', html) == []
    assert "url(" not in html
