"""The page of `oracle score --page` shows every verdict, and escapes the recordings' texts."""

import base64
import hashlib
import re
from datetime import date
from html import unescape
from xml.etree import ElementTree

import numpy as np
import pytest

from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.features import build_manager
from oracle_pipeline.replay.picture import pictures
from oracle_pipeline.reporting import verdict_page
from oracle_pipeline.reporting.badge import as_badge
from oracle_pipeline.reporting.signal_plots import signal_plots
from oracle_pipeline.scoring.isolation import Limits
from oracle_pipeline.scoring.output import MOST_TOLD
from oracle_pipeline.scoring.verdict import Evidence, Verdict, WindowSeries
from tests.recorded_runs import linked

pytestmark = pytest.mark.slow

FEATURE = "redundancy.scan_contradicted"
STARTS_S, VALUES = (0.0, 2.5, 5.0, 7.5, 12.5), (0.01, 0.0, 0.06, None, 0.05)
HOSTILE = "<script>alert(1)</script>\x1b[2J"


def anomalous(recording, **more):
    evidence = (Evidence(FEATURE, 31.0, False, 0.06, "1", 0.0, 0.01, "/scan against /odd", 5.0),)
    families = (FamilyDeviation("redundancy", 1, 5, FEATURE, 31.0, False),)
    return Verdict(
        str(recording), "anomalous", p_value=0.05, suite_p_value=0.05, score=9.0, features=170,
        normal_runs=19, normal_blocks=19, evidence=evidence, families=families,
        **{"series": (WindowSeries(FEATURE, "1", STARTS_S, VALUES, 0.0, 0.02),), **more},
    )  # fmt: skip


@pytest.fixture
def page(tmp_path):
    def write(*verdicts, notes=()):
        place = tmp_path / "page.html"
        verdict_page.write(place, verdicts, 0.05, notes, build_manager(), Limits(), pictures)
        return place.read_text("utf-8")

    return write


def test_a_verdict_stands_beside_its_film_and_the_evidence(recorded_run, page):
    html = unescape(page(anomalous(recorded_run("fake_object").path)))
    film = re.findall(
        r'<img src="data:image/png;base64,([^"]+)" data-at="([^"]+)".*?(hidden)?>', html
    )
    assert len(film) == pytest.approx(verdict_page.FRAMES, abs=2)
    assert all(base64.b64decode(png).startswith(b"\x89PNG") for png, _, _ in film)
    (shown,) = (float(at) for _, at, hidden in film if not hidden)
    assert shown == max(float(at) for _, at, _ in film if float(at) <= 5.0)  # where evidence begins
    assert "Of 19 normal recordings, none is at least as unusual: p = 0.05." in html
    assert build_manager().features()[FEATURE].description in html
    assert "redundancy: 1 of 5 features outside their usual range" in html


def test_a_plot_draws_the_values_of_windows_against_what_normal_windows_reach():
    (plot,) = signal_plots(anomalous("a"), length=20.0)
    drawn = [[tuple(map(float, p.split(","))) for p in line.split()] for line in plot.lines]
    known = [
        (start, value) for start, value in zip(STARTS_S, VALUES, strict=True) if value is not None
    ]
    middle = [(1000 * (start + 2.5) / 20.0, 100 * (0.06 - value) / 0.06) for start, value in known]
    assert np.array(drawn[0]) == pytest.approx(np.array(middle[:3]), abs=0.1)
    assert drawn[1][0] == pytest.approx(middle[3], abs=0.1)  # the missing value parts the line
    assert plot.band == pytest.approx((100 * 0.04 / 0.06, 100 * 0.02 / 0.06), abs=0.1)
    assert plot.evidence == (250.0, 750.0)  # from 5 s on
    assert min(y for _, y in drawn[0]) < plot.band[0]


def test_what_windows_of_the_reference_lack_is_drawn_without_their_range():
    series = WindowSeries(FEATURE, "1", STARTS_S, VALUES, None, None)
    (plot,) = signal_plots(anomalous("a", series=(series,)), length=20.0)
    assert len(plot.lines) == 2
    assert plot.band is None
    assert "an unknown range" in plot.words


def test_a_recording_that_cannot_be_drawn_keeps_its_verdict_with_a_note(tmp_path, page):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag")
    html = page(anomalous(broken), Verdict(str(broken), "error", error="It is no bag."))
    assert "<img" not in html
    assert f"It is not drawn: {broken}" in html
    assert html.index("Anomalous") < html.index("Could not be judged") < html.index("It is no bag.")


def test_breaches_come_first_and_many_of_them_leave_room_for_the_picture(recorded_run, page):
    told = [f"Topic /topic{number} is gone." for number in range(MOST_TOLD + 3)]
    html = page(anomalous(recorded_run("fake_object").path, contract=tuple(told)))
    above, below = html.split("<img", 1)
    assert [each in above for each in told] == [True] * MOST_TOLD + [False] * 3
    assert above.index(told[0]) < above.index("Of 19 normal recordings")
    assert "and 3 more differences from the contract; the remarks list all." in above
    assert all(each in below for each in told[MOST_TOLD:])


def test_names_and_texts_of_a_recording_are_escaped(recorded_run, tmp_path, page):
    run = linked(recorded_run("fake_object"), tmp_path / "<script>")
    html = page(anomalous(run.path, contract=(HOSTILE,)), notes=(HOSTILE,))
    (script,) = re.findall("<script>(.*?)</script>", html, re.DOTALL)  # ours, by its hash
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert html.count("<script") == 1
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src" in html
    assert f"script-src 'sha256-{digest}'\"" in html
    assert "alert" not in script
    assert "\x1b" not in html
    assert html.count("&lt;script&gt;") >= 3


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
