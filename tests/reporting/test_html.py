import base64
import re
from html.parser import HTMLParser

import pytest

from oracle_pipeline.reporting.html import provenance, render, write_page
from oracle_pipeline.reporting.reports import (
    bootstrapped_dataset,
    clustering_grid_search,
    malicious_rate_report,
    oracle_evaluation,
    pairwise_report,
)
from tests.datasets.synthetic import run_features

VOID = {"meta", "img", "link", "br"}
N = 60


class Page(HTMLParser):
    """Every tag, every text and every place that a browser would load something from."""

    def __init__(self, text):
        super().__init__()
        self.open, self.loaded, self.images, self.texts, self.cells = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        attrs = dict(attrs)
        self.loaded += [attrs[name] for name in ("src", "href", "srcset") if name in attrs]
        if tag == "img":
            self.images.append(attrs)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)
        if "td" in self.open:
            self.cells[-1] += data


def page_of(df, runs=None, **said):
    return render(
        df,
        grid=clustering_grid_search(bootstrapped_dataset(df, N).table),
        rates=malicious_rate_report(df, N),
        pairs=pairwise_report(df, N),
        evaluation=oracle_evaluation(df),
        runs=runs or {},
        provenance={**provenance(df), **said},
    )


@pytest.fixture(scope="module")
def page():
    df = run_features(runs=3)
    picture = oracle_evaluation(df).figures["roc"]
    return page_of(df, {"fake_object|run000, attacked": picture}, Note="<script>alert(1)</script>")


def test_the_page_holds_everything_it_shows(page):
    parsed = Page(page)
    assert parsed.open == []
    assert parsed.loaded
    assert all(place.startswith("data:image/png;base64,") for place in parsed.loaded)
    assert "url(" not in page
    assert "@import" not in page
    for image in parsed.images:
        assert image["alt"]
        png = base64.b64decode(image["src"].partition(",")[2])
        assert png.startswith(b"\x89PNG")


def test_what_is_said_is_text_and_never_markup(page):
    assert "<script" not in page
    assert "<script>alert(1)</script>" in "".join(Page(page).texts)


def test_no_figure_of_ours_stands_without_its_interval(page):
    cells = [cell for cell in Page(page).cells if re.match(r"\d\.\d\d\[", cell)]
    assert len(cells) > 16 * 8
    assert all(re.fullmatch(r"\d\.\d\d\[\d\.\d\d, \d\.\d\d\]", cell) for cell in cells)
    (answer,) = re.findall(r'class="answer">([^<]*)<', page)
    assert re.search(r"AUC \d\.\d\d \[\d\.\d\d, \d\.\d\d\]", answer)


def test_the_page_says_first_what_the_runs_cannot_support(page):
    assert page.index("9 right runs cannot support") < page.index("<h2>")


def test_the_page_reads_in_light_in_dark_on_paper_and_on_a_phone(page):
    for need in ("prefers-color-scheme: dark", "@media print", "width=device-width", "overflow-x"):
        assert need in page


def test_the_page_comes_whole_into_its_place(page, tmp_path):
    path = tmp_path / "report" / "index.html"
    write_page(page, path)
    assert path.read_text(encoding="utf-8") == page
    assert list(path.parent.iterdir()) == [path]
