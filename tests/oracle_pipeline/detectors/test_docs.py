"""Keeps docs/explanation/detectors.md true."""

import re
from pathlib import Path

from oracle_pipeline.detectors import DEFAULT_DETECTOR, panel

PAGE = (Path(__file__).parents[3] / "docs" / "explanation" / "detectors.md").read_text("utf-8")


def test_the_page_lists_the_panel_in_its_order_and_names_the_default():
    section = PAGE.partition("## The panel")[2].partition("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", section, re.M) == list(panel(seed=0))
    assert f"`DEFAULT_DETECTOR` is `{DEFAULT_DETECTOR}`" in PAGE
