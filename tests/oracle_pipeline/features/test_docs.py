"""Keeps docs/reference/features.md and docs/how-to/plugins.md true.

Run as a script, it writes the table of features.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from oracle_pipeline import features
from oracle_pipeline.features.manager import FeatureManager
from oracle_pipeline.opened_run import open_run

DOCS = Path(__file__).parents[3] / "docs"
PAGE, PLUGINS = DOCS / "reference" / "features.md", DOCS / "how-to" / "plugins.md"
BEGIN, END = "<!-- features: begin -->\n", "<!-- features: end -->\n"


def table(manager: FeatureManager) -> str:
    lines = ["| column | unit | floor | origin | windows | what it is |", "| --- " * 6 + "|"]
    for column, feature in manager.features().items():
        windows = "yes" if feature.per_window else "no"
        marks = {"shortcut": feature.shortcut, "behaviour": feature.behaviour}
        origin = ", ".join([feature.origin, *(mark for mark, given in marks.items() if given)])
        lines.append(
            f"| `{column}` | {feature.unit} | {feature.floor:g} | {origin} | {windows} "
            f"| {feature.description} |"
        )
    return "\n".join(lines) + "\n"


def code_blocks() -> dict[str, str]:
    """Return the plugins on the page, by file name."""
    text = PLUGINS.read_text("utf-8")
    blocks = re.findall(r"```python\n(# plugins/(\w+\.py)\n.*?)```", text, re.S)
    return {name: code for code, name in blocks}


def test_the_page_lists_every_built_in_feature(monkeypatch):
    monkeypatch.delenv("ORACLE_PLUGINS", raising=False)
    written = PAGE.read_text("utf-8").partition(BEGIN)[2].partition(END)[0]
    assert written == table(features.build_manager()), f"run {Path(__file__).name} as a script"


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


if __name__ == "__main__":
    before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
    PAGE.write_text(
        before + BEGIN + table(features.build_manager()) + END + rest.partition(END)[2], "utf-8"
    )
