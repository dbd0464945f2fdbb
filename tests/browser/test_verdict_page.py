"""The page of `oracle score --page` in a browser."""

import io
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import sync_playwright

from oracle_pipeline.features import build_manager
from oracle_pipeline.reporting import verdict_page
from oracle_pipeline.scoring.isolation import Limits
from oracle_pipeline.scoring.verdict import Evidence, Verdict, WindowSeries
from tests.browser.chromium import CHROMIUM

LONG = ("kinematics.travel_scale_joints_orientation", "redundancy.scan_contradicted")


def drawn(recording: Path, number: int) -> list[tuple[float, bytes]]:
    """Return pictures for any recording, one a second."""
    png = io.BytesIO()
    Image.new("RGB", (600, 600), "grey").save(png, "PNG")
    return [(float(at), png.getvalue()) for at in range(number)]


def verdict(folder: str) -> Verdict:
    evidence = tuple(
        Evidence(name, -50.0, True, -0.05652, "rad/s", -0.04724, -0.002067,
                 "/local_costmap/clearing_endpoints against /scan_fakeobject", 17.5)
        for name in LONG
    )  # fmt: skip
    return Verdict(
        f"/data/recordings/{folder}/lidar_passthrough_odom/run900", "anomalous", p_value=0.05,
        suite_p_value=0.05, score=9.0, features=170, normal_runs=19, normal_blocks=19,
        evidence=evidence,
        series=(WindowSeries(LONG[0], "1", (0.0, 20.0, 40.0), (0.1, 0.9, 0.1), 0.0, 0.2),),
    )  # fmt: skip


@pytest.mark.parametrize("width", [1280, 390])
def test_no_column_of_the_evidence_is_cut_off(tmp_path: Path, width: int) -> None:
    path = tmp_path / "page.html"
    verdicts = [verdict("first"), verdict("second")]
    verdict_page.write(path, verdicts, 0.05, (), build_manager(), Limits(), drawn)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM)
        page = chromium.new_page(viewport={"width": width, "height": 900})
        page.goto(path.as_uri())
        boxes = page.locator(".scroll")
        wider = boxes.evaluate_all("all => all.map(box => box.scrollWidth - box.clientWidth)")
        root = "document.documentElement"
        assert wider == [0, 0]
        assert page.evaluate(f"{root}.scrollWidth - {root}.clientWidth") <= 0
        chromium.close()


def test_the_slider_moves_film_and_plots_from_the_evidence_to_any_time(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    verdict_page.write(path, [verdict("one")], 0.05, (), build_manager(), Limits(), drawn)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM)
        page = chromium.new_page()
        page.goto(path.as_uri())
        slider, frames, now = (page.locator(of) for of in ("input", ".film img", ".now"))

        def seen() -> tuple[str | None, float, str]:
            (at,) = frames.evaluate_all(
                "all => all.filter(f => f.checkVisibility()).map(f => f.dataset.at)"
            )
            return at, float(now.get_attribute("x1") or 0), page.locator("output").inner_text()

        last = verdict_page.FRAMES - 1.0  # the end of the film, after the last window
        assert seen() == ("17.0", pytest.approx(1000 * 17.5 / last), "17.5 s")
        slider.fill("42.3")
        assert seen() == ("42.0", pytest.approx(1000 * 42.3 / last), "42.3 s")
        slider.focus()
        page.keyboard.press("Home")
        assert seen() == ("0.0", 0.0, "0.0 s")
        chromium.close()
