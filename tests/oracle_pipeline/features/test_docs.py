"""Keeps docs/how-to/plugins.md true."""

import re
from pathlib import Path

import numpy as np
import pytest

from oracle_pipeline import features
from oracle_pipeline.opened_run import open_run

PLUGINS = Path(__file__).parents[3] / "docs" / "how-to" / "plugins.md"


def code_blocks() -> dict[str, str]:
    """Return the plugins on the page, by file name."""
    text = PLUGINS.read_text("utf-8")
    blocks = re.findall(r"```python\n(# plugins/(\w+\.py)\n.*?)```", text, re.S)
    return {name: code for code, name in blocks}


@pytest.mark.parametrize(
    ("file", "column", "value"),
    [
        ("clearance.py", "safety.clearance", 0.5),
        ("traffic.py", "thesis.traffic_1", 415 / 27),
        ("traffic.py", "thesis.traffic_2", 3.5),
    ],
)
def test_the_plugins_on_the_page_work(file, column, value, make_run, tmp_path):
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / file).write_text(code_blocks()[file])
    with open_run(make_run().path) as run:
        tables = features.extract(run, features.build_manager(tmp_path / "plugins"))
    assert tables.run[column].tolist() == pytest.approx([value], abs=1e-3)
    assert np.isfinite(tables.run[column]).all()
