"""The shipped reference card fits the code: `make demo` distinguishes its two runs by it."""

import re

import numpy as np
import pytest

from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring.card import ReferenceCard
from tools.scripts import demo
from tools.scripts.compile_loops import SHORT

pytestmark = pytest.mark.slow(6)

LARGEST = 5 * 2**20  # bytes of a tracked file: 40 runs, with the models of their signals


def test_the_demo_shows_a_normal_and_an_attacked_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ORACLE_HOME", str(tmp_path))
    assert demo.main() == 0
    page = tmp_path / "demo" / "index.html"
    assert page.as_uri() in capsys.readouterr().out
    html = page.read_text("utf-8")
    assert html.index(">Normal<") < html.index(">Anomalous<")
    shown = [tag for tag in re.findall(r"<img [^>]+>", html) if " hidden" not in tag]
    assert len(shown) == 2  # other frames of their films are hidden


def test_an_outdated_card_ends_the_demo_with_a_remedy(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ORACLE_HOME", str(tmp_path))
    monkeypatch.setattr(demo, "ATTACKED", demo.NORMAL)
    assert demo.main() == 1
    assert "make demo-card" in capsys.readouterr().err


def test_the_shipped_card_is_small_and_knows_the_features_of_the_code():
    assert demo.CARD.stat().st_size <= LARGEST
    card = ReferenceCard.load(demo.CARD)
    known = set(build_manager().features())
    assert set(card.scorer.design.run_features) <= known
    assert card.runs["block"].nunique() >= 39  # two recordings judged together, at 5 %
    assert demo.BLOCK not in set(card.runs["block"])


def test_the_short_recording_has_nearly_all_features_that_the_card_has():
    columns = ReferenceCard.load(demo.CARD).scorer.design.run_features
    with open_run(SHORT) as run:
        row = extract(run, build_manager()).run.iloc[0]
    assert np.isfinite(row[list(columns)].to_numpy(dtype=float)).mean() > 0.9
