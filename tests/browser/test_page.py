"""The report as a browser shows it; ``make test-browser`` runs this, for it needs a Chromium."""

import io

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from oracle_pipeline.reporting.run_pages import write_run_pages
from tests.browser.chromium import CHROMIUM
from tests.oracle_pipeline.reporting.test_run_pages import ATTACKED, shown_runs

pytestmark = pytest.mark.slow

DESK, PHONE = {"width": 1280, "height": 800}, {"width": 360, "height": 780}
PAPER = {"width": 687, "height": 1010}  # A4 less its margins, at 96 pixels an inch


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM)
        yield chromium
        chromium.close()


@pytest.fixture(autouse=True)
def windows_are_closed(browser):
    yield
    for context in browser.contexts:
        context.close()


@pytest.fixture(scope="module")
def run_page(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    write_run_pages(shown_runs(root), root / "report" / "runs")
    return root / "report" / "runs" / f"{ATTACKED.replace('|', '/')}.html"


@pytest.fixture(scope="module", params=["whole", "poor", "large"])
def report(request, report_pages):
    return report_pages / f"{request.param}.html"


class Visit:
    """The report opened in a new window, and the browser's console messages."""

    def __init__(self, browser: Browser, report, size=DESK, scheme="light"):
        self.page = browser.new_page(viewport=size, color_scheme=scheme)
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(report.as_uri())

    def overflow(self):
        """Return by how many pixels the page is wider than the window."""
        root = "document.documentElement"
        return self.page.evaluate(f"{root}.scrollWidth - {root}.clientWidth")

    def brightness(self):
        """Return the mean brightness of the window, in [0, 1]."""
        with Image.open(io.BytesIO(self.page.screenshot())) as png:
            return float(np.asarray(png.convert("L")).mean() / 255.0)


def test_the_page_logs_nothing_and_requests_no_other_file(browser, report):
    visit = Visit(browser, report)
    visit.page.wait_for_load_state("networkidle")
    assert visit.said == []
    assert [url for url in visit.asked if not url.startswith("data:")] == [report.as_uri()]


def test_every_picture_exists_and_has_an_alternative_text(browser, report):
    pictures = Visit(browser, report).page.locator("img")
    shown = pictures.evaluate_all("all => all.map(img => [img.alt, img.naturalWidth])")
    assert len(shown) == 2 or report.stem == "poor"
    assert all(alt and width > 0 for alt, width in shown)


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_the_first_screen_answers_without_scrolling(browser, report, size):
    page = Visit(browser, report, size).page
    answers = [page.locator(".answer"), *page.locator(".first section").all()]
    plot = page.locator(".strips .strip svg[role=img]")
    assert all(answer.inner_text().strip() for answer in answers)
    ends = [answer.bounding_box() for answer in answers]
    assert all(box["y"] + box["height"] <= size["height"] for box in ends)
    if size is DESK and plot.count():
        last = plot.last.bounding_box()
        assert last["y"] + last["height"] <= size["height"]


def test_a_mark_leads_to_the_page_of_its_run(browser, report):
    marks = Visit(browser, report).page.locator(".strip svg a")
    if marks.count():
        assert marks.first.get_attribute("href").startswith("runs/")
        assert marks.first.locator("title").text_content()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_the_page_of_a_run_reads_on_any_screen(browser, run_page, size, scheme):
    visit = Visit(browser, run_page, size, scheme)
    assert visit.said == []
    assert [url for url in visit.asked if not url.startswith("data:")] == [run_page.as_uri()]
    assert visit.overflow() == 0
    assert (visit.brightness() > 0.8) == (scheme == "light")


def test_the_pages_of_runs_lead_to_each_other_and_to_the_list(browser, run_page):
    page = Visit(browser, run_page).page
    page.get_by_role("link", name="runs", exact=True).click()
    page.get_by_role("link", name=ATTACKED).click()
    assert page.url == run_page.as_uri()


def test_light_and_dark_schemes_have_their_backgrounds(browser, report):
    light, dark = (Visit(browser, report, scheme=scheme) for scheme in ("light", "dark"))
    assert light.brightness() > 0.85
    assert dark.brightness() < 0.25


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_only_tables_and_wide_pictures_scroll_sideways_each_in_its_own_box(browser, report, size):
    visit = Visit(browser, report, size)
    assert visit.overflow() == 0
    boxes = visit.page.locator(".scroll, figure.wide")
    widths = boxes.evaluate_all("all => all.map(box => [box.scrollWidth, box.clientWidth])")
    assert any(inside > box for inside, box in widths) or size is DESK
    assert all(box <= size["width"] for _, box in widths)


def test_a_link_leads_to_its_section(browser, report):
    visit = Visit(browser, report, PHONE)
    visit.page.get_by_role("link", name="The thesis's method on these runs").click()
    assert visit.page.locator("#thesis").bounding_box()["y"] < PHONE["height"]


def test_tables_can_be_reached_and_scrolled_by_keyboard(browser, report):
    visit = Visit(browser, report, PHONE)
    box = visit.page.locator(".scroll").first
    box.focus()
    visit.page.keyboard.press("ArrowRight")
    # The page forbids `eval`, which Playwright's own waiting would use from its second look on.
    assert box.evaluate(
        """box => new Promise(done => {
            box.addEventListener("scroll", () => done(true), {once: true});
            if (box.scrollLeft > 0) done(true);
            setTimeout(() => done(false), 5000);
        })"""
    )


def test_the_page_fits_on_paper_which_is_white(browser, report):
    visit = Visit(browser, report, PAPER, scheme="dark")
    visit.page.emulate_media(media="print")
    assert visit.overflow() == 0
    assert visit.brightness() > 0.85
    printed = visit.page.pdf(prefer_css_page_size=True)
    assert printed.startswith(b"%PDF")
    assert printed.count(b"/Type /Page\n") > 3
