"""The architecture page describes every package of the code."""

import importlib.util
import re
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"


def test_the_page_has_a_row_for_every_room():
    spec = importlib.util.spec_from_file_location("draw", DOCS / "draw_architecture.py")
    draw = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw)
    page = (DOCS / "explanation" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[^|]+`) \|", page.partition("## Rooms")[2], re.MULTILINE)
    described = {room for row in rows for room in re.findall(r"`([\w.]+)`", row)}
    assert described == set(draw.room_graph())
