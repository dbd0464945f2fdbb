"""Tampering and misbehaviour in words: the tables of a run's page."""

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.behaviour import UNITS
from oracle_pipeline.reporting.two_scores import scores_table, task_table
from tests.oracle_pipeline.reporting.recordings import manifest

NONE = np.nan


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


def test_a_system_without_goals_has_no_row() -> None:
    assert task_table(None, manifest(drive=None, goal_results=()), {}).rows == []
