"""The page of `oracle score --page` in a browser."""

import io
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import sync_playwright

from oracle_pipeline.features import build_manager
from oracle_pipeline.reporting import verdict_page
from oracle_pipeline.scoring.isolation import Limits
from oracle_pipeline.scoring.verdict import Evidence, Verdict
from tests.browser.chromium import CHROMIUM

LONG = ("kinematics.travel_scale_joints_orientation", "redundancy.scan_contradicted")


def grey(recording: Path) -> bytes:
    """Return a picture for any recording."""
    png = io.BytesIO()
    Image.new("RGB", (600, 600), "grey").save(png, "PNG")
    return png.getvalue()


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
    )  # fmt: skip


@pytest.mark.parametrize("width", [1280, 390])
def test_no_column_of_the_evidence_is_cut_off(tmp_path: Path, width: int) -> None:
    path = tmp_path / "page.html"
    verdicts = [verdict("first"), verdict("second")]
    verdict_page.write(path, verdicts, 0.05, (), build_manager(), Limits(), grey)
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
