"""The page on a running watch as a browser shows it."""

import re
from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from oracle_pipeline.live.events import WindowAlarm
from oracle_pipeline.live.page_server import LivePage
from tests.browser.chromium import CHROMIUM
from tests.oracle_pipeline.live.happenings import HOSTILE, events, messages, verdict


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM)
        yield chromium
        chromium.close()


class Visit:
    """A window on a watch, and the browser's console messages."""

    def __init__(self, browser: Browser, live: LivePage, width: int = 1200) -> None:
        self.live = live
        self.said: list[str] = []
        self.asked: list[str] = []
        self.page: Page = browser.new_page(viewport={"width": width, "height": 900})
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(live.address)


@pytest.fixture
def live() -> Iterator[LivePage]:
    with LivePage(0) as page:
        yield page


def test_a_window_that_is_open_sees_what_happens(browser: Browser, live: LivePage) -> None:
    visit = Visit(browser, live)
    page = visit.page
    expect(page.locator("#verdict")).to_have_text("no verdict yet")
    for message in messages():
        live.show(message)
    expect(page.locator("#status")).to_have_text(
        re.compile(r"0:27 recorded, \d+ messages received")
    )
    expect(page.locator("#scans")).to_contain_text("/scan")
    assert page.locator("#above circle.ray").count() > 10
    assert page.locator("#above polyline.path").get_attribute("points")
    live.show(verdict(1))
    expect(page.locator("#verdict")).to_have_text(re.compile("^normal at 0:07, p = 0.60"))
    last = verdict(2, alarm=True)
    live.show(last)
    live.show(WindowAlarm(last))
    expect(page.locator("#verdict")).to_have_class("anomalous")
    expect(page.locator("#score circle.hit")).to_have_count(1)
    expect(page.locator("#score")).to_contain_text("alarm above 4.0")
    expect(page.locator("#alarms summary")).to_have_text(re.compile("Window 0:05 to 0:10"))
    expect(page.locator("#alarms td").first).to_have_text("redundancy.<b>scan</b>")
    assert visit.said == []


def test_a_late_window_gets_all_data_and_names_of_the_robot_are_text(
    browser: Browser, live: LivePage
) -> None:
    for event in events():
        live.show(event)
    visit = Visit(browser, live)
    page = visit.page
    expect(page.locator("#counts")).to_have_text(re.compile(r"\d+ nodes, \d+ topics"))
    shown = page.locator("#graph text", has_text="<img src=x")
    expect(shown).to_have_count(1)
    assert "\x1b" not in (shown.text_content() or "")
    assert HOSTILE[:10] in (shown.text_content() or "")
    assert page.locator("#graph img").count() == 0
    assert page.title() == "Behavioural oracle: live"
    expect(page.locator("#notes li")).to_have_text(re.compile("3 messages were dropped"))
    assert visit.said == []
    assert {url.removeprefix(live.address) for url in visit.asked} <= {"/", "/events", "data:,"}


def test_each_robot_of_a_fleet_has_its_own_line(browser: Browser, live: LivePage) -> None:
    for number in (1, 2):
        for robot in ("robot1", "robot2"):
            live.show(replace(verdict(number), robot=robot, is_usual=robot != "robot1"))
    page = Visit(browser, live).page
    expect(page.locator("#score polyline.score")).to_have_count(2)
    expect(page.locator("#verdict")).to_have_text(re.compile("^unusual: robot1 at 0:10"))


def test_the_edges_of_a_vertex_stand_out_under_the_pointer(
    browser: Browser, live: LivePage
) -> None:
    for event in events():
        live.show(event)
    page = Visit(browser, live).page
    page.locator("#graph text", has_text="/amcl").hover()
    expect(page.locator("#graph line.on")).to_have_count(1)


@pytest.mark.parametrize("width", [360, 1200, 1280])
def test_the_page_is_no_wider_than_the_window(browser: Browser, live: LivePage, width: int) -> None:
    for event in events():
        live.show(event)
    page = Visit(browser, live, width).page
    expect(page.locator("#alarms summary")).to_have_count(1)
    if width > 1000:  # nothing of the evidence is cut off
        table = page.locator("#alarms table")
        assert table.evaluate("t => t.parentElement.clientWidth - t.scrollWidth") >= 0
        assert page.locator("#seen").evaluate("s => s.clientWidth - s.scrollWidth") >= 0
    root = "document.documentElement"
    assert page.evaluate(f"{root}.scrollWidth - {root}.clientWidth") <= 0


def test_the_page_shows_the_end_of_the_watch(browser: Browser) -> None:
    with LivePage(0) as live:
        for event in events():
            live.show(event)
        page = Visit(browser, live).page
        expect(page.locator("#status")).to_contain_text("recorded")
    expect(page.locator("#status")).to_contain_text("the watch has ended")
