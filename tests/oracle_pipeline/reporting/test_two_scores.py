"""Tampering and misbehaviour in words: kinds of runs, and the tables of a run's page."""

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.behaviour import UNITS
from oracle_pipeline.evaluation.ranking import standing
from oracle_pipeline.reporting.strip_plot import strip_plot
from oracle_pipeline.reporting.two_scores import (
    KINDS,
    called_kinds,
    counted,
    scores_table,
    task_table,
    true_kinds,
)
from tests.oracle_pipeline.reporting.recordings import manifest

LOW, HIGH, NONE = 0.01, 0.5, np.nan
RUNS = pd.DataFrame(
    {
        "run_id": [f"{mode}|run{n:03d}" for mode in ("attack", "normal") for n in range(3)],
        "mode": ["attack"] * 3 + ["normal"] * 3,
        "label": ["malicious"] * 3 + ["normal"] * 3,
        "score": [9.0, 8.0, 7.0, 1.0, 0.0, -1.0],
        "p": [LOW] * 3 + [HIGH] * 3,
        "tampering_p": [LOW, LOW, HIGH, HIGH, LOW, NONE],
        "misbehaviour_p": [HIGH, LOW, LOW, HIGH, NONE, NONE],
        "effect": [0.5, 2.0, NONE, 1.0, 1.5, NONE],
    }
)


def test_a_run_is_tampered_misbehaved_both_or_neither_by_its_two_p_values() -> None:
    kinds = called_kinds(RUNS)
    assert kinds[:4].tolist() == ["tampered", "both", "misbehaved", "neither"]
    assert kinds[4:].isna().all()  # one p-value alone is no verdict


def test_the_true_kind_follows_from_label_and_effect() -> None:
    kinds = true_kinds(RUNS)
    known = ["tampered", "both", "neither", "misbehaved"]
    assert kinds[[0, 1, 3, 4]].tolist() == known
    assert kinds[[2, 5]].isna().all()


def test_unknown_kinds_are_not_counted() -> None:
    assert counted(called_kinds(RUNS.assign(tampering_p=np.nan))) == ""
    said = counted(true_kinds(RUNS))
    assert said == "1 tampered only, 1 misbehaved only, 1 both, 1 neither"


def test_the_plot_counts_the_kinds_of_each_mode() -> None:
    plot = strip_plot(RUNS, standing(RUNS), lambda run: run)
    assert plot is not None
    assert plot.kinds == KINDS
    assert {strip.mode: list(strip.kinds) for strip in plot.strips} == {
        "attack": [1, 1, 1, 0],
        "normal": [0, 0, 0, 1],
    }
    few = RUNS.assign(misbehaviour_p=np.nan)
    without = strip_plot(few, standing(few), lambda run: run)
    assert without is not None
    assert (without.kinds, without.strips[0].kinds, without.strips[0].note) == ((), [], "3")


def words(effect: float, **differences: float) -> str:
    """Return the true misbehaviour in the table of scores."""
    row = pd.Series(
        {f"{aspect}_{name}": NONE for aspect in ("tampering", "misbehaviour")
         for name in ("score", "p")}
        | {"effect": effect, **dict.fromkeys(UNITS, 0.0), **differences}
    )  # fmt: skip
    usual = {**dict.fromkeys(UNITS, 1.0), "clearance_m": 0.05}
    table = scores_table(row, manifest(label="normal"), usual)
    return table.rows[1][-1].text


@pytest.mark.parametrize(
    ("effect", "differences", "said"),
    [
        (NONE, {}, "unknown: it needs 20 unaltered runs, one of them in this block"),
        (0.9, {"driven_m": 0.9}, "did not misbehave: like unaltered runs of its block"),
        (2.4, {"clearance_m": -0.12, "driven_m": 0.9}, "misbehaved: clearance -0.12 m"),
        (3.0, {"recoveries": 3.0, "under_way_s": 12.5},
         "misbehaved: under way +12.5 s, recoveries +3"),
    ],
)  # fmt: skip
def test_misbehaviour_lists_the_quantities_that_differ(
    effect: float, differences: dict[str, float], said: str
) -> None:
    assert words(effect, **differences) == said


def test_a_system_that_does_not_drive_has_no_row() -> None:
    assert task_table(None, manifest(drive=None), {}).rows == []
