import base64
import re
from html.parser import HTMLParser
from itertools import product

import pytest

from oracle_pipeline.reporting.html import write_page

pytestmark = pytest.mark.slow(2)

VOID = {"meta", "img", "link", "br"}
FIRST = ["recorded", "found", "open"]
EVERYTHING = [
    "verdicts", "searched", "alarms", "integrity", "scorers",
    "magnitude", "thesis", "storage", "reading", "provenance",
]  # fmt: skip
LARGEST = 1_000_000  # bytes of the main page, so that it opens at once
READABLE = 4.5  # contrast of text, WCAG 2.2, level AA


class Page(HTMLParser):
    """Every tag, every text and every place that a browser would load something from."""

    def __init__(self, text):
        super().__init__()
        self.open, self.loaded, self.images, self.texts, self.cells = [], [], [], [], []
        self.headings, self.links, self.ids, self.tables, self.captions = [], [], [], 0, []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        attrs = dict(attrs)
        self.loaded += [attrs[name] for name in ("src", "srcset", "data") if name in attrs]
        if tag != "use":
            self.links += [attrs[name] for name in ("href", "aria-labelledby") if name in attrs]
        self.ids += [attrs["id"]] if "id" in attrs else []
        self.tables += tag == "table"
        if tag == "h2":
            self.headings.append(attrs["id"])
        if tag == "img":
            self.images.append(attrs)
        if tag == "td":
            self.cells.append("")
        if tag == "caption":
            self.captions.append("")

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)
        if "td" in self.open:
            self.cells[-1] += data
        if "caption" in self.open:
            self.captions[-1] += data


@pytest.fixture(scope="module")
def page(report_pages):
    return (report_pages / "whole.html").read_text("utf-8")


@pytest.fixture(scope="module")
def poor(report_pages):
    return (report_pages / "poor.html").read_text("utf-8")


def answer(page):
    (said,) = re.findall(r'class="answer">([^<]*)<', page)
    return said


def test_the_page_is_self_contained(page):
    parsed = Page(page)
    assert parsed.open == []
    assert parsed.loaded
    assert all(place.startswith("data:image/png;base64,") for place in parsed.loaded)
    assert "url(" not in page
    assert "@import" not in page
    for place in parsed.loaded:
        assert base64.b64decode(place.partition(",")[2]).startswith(b"\x89PNG")


def test_texts_are_escaped(page):
    assert "<script" not in page
    assert "<script>alert(1)</script>" in "".join(Page(page).texts)


def test_every_section_is_present_in_order(page, poor):
    whole, part = Page(page), Page(poor)
    assert whole.headings == FIRST[:2] + EVERYTHING  # nothing is open
    absent = {"magnitude", "searched", "storage"}
    assert part.headings == FIRST + [name for name in EVERYTHING if name not in absent]
    for parsed in (whole, part):
        assert len(set(parsed.ids)) == len(parsed.ids)
        inside = {link.lstrip("#") for link in parsed.links if ".html" not in link}
        assert inside == set(parsed.headings)


def test_every_picture_has_an_alternative_text_and_every_table_a_caption(page):
    parsed = Page(page)
    described = [image["alt"] for image in parsed.images]
    assert all(described)
    assert len(parsed.captions) == parsed.tables
    assert all(parsed.captions)


def test_every_result_of_ours_has_its_interval(page):
    number = r"-?\d+\.\d\d"
    cells = [cell for cell in Page(page).cells if re.match(rf"{number}\[", cell)]
    assert len(cells) > 16 * 8
    assert all(re.fullmatch(rf"{number}\[{number}, {number}\]", cell) for cell in cells)


def test_the_headline_is_the_evaluations(page):
    rate = r"\d\.\d\d \[\d\.\d\d, \d\.\d\d\]"
    assert re.fullmatch(
        f"Exit code 1 for {rate} of attacked and {rate} of normal runs.", answer(page)
    )


def test_a_small_campaign_has_its_missing_runs_and_the_command_that_records_them(poor):
    first = poor.split("<nav")[0]
    assert "Withheld" not in poor
    assert "withheld" not in poor
    assert "Exit code" not in answer(poor)
    assert "A false positive rate of 5%" in first
    assert "It needs normal recordings of 24 blocks; you have 2" in first
    assert re.search(r"<code[^>]*>record [\w ]+ in 24 blocks</code>", first)


def test_the_first_screen_describes_the_campaign_and_links_every_run(page):
    first = page.split("<nav")[0]
    assert "330 runs: 90 attacked, 240 normal. 11 modes, 30 blocks, 3 sessions" in first
    marks = re.findall(r'<a href="runs/(\w+)/run(\d{3}).html" tabindex="-1">', first)
    assert len(set(marks)) == 330
    assert "At a nominal false positive rate of 5%" in first


def test_the_first_screen_says_how_many_runs_are_left_out(page, poor):
    assert "1 more run ended before the onset: left out." in poor.split("<nav")[0]
    assert "before the onset" not in page.split("<nav")[0]


def test_the_page_of_840_runs_is_small_and_marks_every_run(report_pages):
    page = (report_pages / "large.html").read_text("utf-8")
    assert len(page.encode()) < LARGEST
    assert len(set(re.findall(r'href="(runs/\w+/run\d{3}.html)" tabindex', page))) == 840


def test_every_check_has_its_result_as_text(page, poor):
    panel = re.findall(r'<span class="status (\w+)">(\S) (\w+)</span>', page + poor)
    assert len(panel) == 8
    assert all(status == word for status, _, word in panel)
    assert {(mark, word) for _, mark, word in panel} >= {("✓", "green"), ("?", "unsupported")}


def test_a_note_is_printed_once_below_its_table_and_numbered_in_it(poor):
    section = poor[poor.index(">Side by side<") : poor.index(">Linkage, criterion and threshold")]
    assert section.count("No run has all ten features") == 1
    assert len(re.findall(r"<td[^>]*>1</td>\n</tr>", section)) > 10


def test_the_page_has_styles_for_light_dark_print_and_phones(page):
    for need in ("prefers-color-scheme: dark", "@media print", "width=device-width", "overflow-x"):
        assert need in page


def luminance(ink):
    channels = [int(ink[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return sum(c * weight for c, weight in zip(linear, (0.2126, 0.7152, 0.0722), strict=True))


def contrast(one, other):
    dark, light = sorted(map(luminance, (one, other)))
    return (light + 0.05) / (dark + 0.05)


def test_contrast_is_that_of_black_on_white_and_of_equal_inks():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
    assert contrast("#123456", "#123456") == 1.0


def test_all_inks_can_be_read_in_light_in_dark_and_on_paper(page):
    schemes = [dict(re.findall(r"--([\w-]+): (#\w{6})", part))
               for part in re.findall(r":root \{(.*?)\}", page, re.DOTALL)]  # fmt: skip
    assert len(schemes) == 3
    for inks in schemes:
        for ink, paper in [
            *product(("ink", "soft", "accent"), ("paper", "tint")),
            ("warn", "warn-tint"), ("good", "good-tint"), ("bad", "bad-tint"),
            ("malicious", "paper"), ("normal", "paper"), ("control", "paper"),
        ]:  # fmt: skip
            assert contrast(inks[ink], inks[paper]) >= READABLE, (ink, paper)


def test_the_page_is_written_atomically(page, tmp_path):
    path = tmp_path / "report" / "index.html"
    write_page(page, path)
    assert path.read_text(encoding="utf-8") == page
    assert list(path.parent.iterdir()) == [path]
