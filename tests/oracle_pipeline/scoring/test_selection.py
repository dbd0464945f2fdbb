"""A reference survives copies, and recordings that are unlike all others."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.reference import Reference
from oracle_pipeline.scoring.selection import MOST_ODD, odd

FEATURES = [f"contextual.f{number}" for number in range(20)]


def reference(count: int = 30, seed: int = 0) -> pd.DataFrame:
    """Return a table of normal recordings."""
    rng = np.random.default_rng(seed)
    keys = {"mode": "m", "label": "normal", "block": range(count), "session": range(count)}
    df = pd.DataFrame({"run_id": [f"run{n:03d}" for n in range(count)], **keys, "world": 0})
    df[FEATURES] = rng.normal(size=(count, len(FEATURES)))
    return df.assign(where="{}", missing="{}")


def attacked(count: int = 20) -> pd.DataFrame:
    table = reference(count, seed=1)
    table[FEATURES[:5]] += 8.0
    return table


def p_values(table: pd.DataFrame, new: pd.DataFrame) -> np.ndarray:
    from oracle_pipeline.scoring.measured_runs import MeasuredRuns

    card = learn(Reference(table))
    windows = pd.DataFrame({"run_id": new["run_id"], "window_start_s": 0.0})
    scores = card.scorer.scores(MeasuredRuns.ordered(new, windows))
    return card.scorer.p_values(scores)


def with_odd(table: pd.DataFrame, count: int) -> pd.DataFrame:
    """Return a table in which some recordings failed, each in its own way."""
    table = table.copy()
    for number in range(count):
        table.loc[number, FEATURES[number : number + 8]] = 200.0 * (number + 1)
    return table


@pytest.mark.parametrize("count", [1, 2, 3])
def test_up_to_a_tenth_of_odd_recordings_hides_no_attack(count):
    clean = p_values(reference(), attacked())
    contaminated = p_values(with_odd(reference(), count), attacked())
    assert np.mean(contaminated <= 0.05) >= np.mean(clean <= 0.05) - 0.03


def test_odd_recording_is_named_with_the_share_that_verdicts_miss():
    card = learn(Reference(with_odd(reference(), 2)))
    (note,) = [note for note in card.notes if "set aside" in note]
    assert note.startswith("run000, run001: set aside")
    assert "2 of 30 normal ones here" in note
    assert len(card.runs) == 28


def test_usual_recordings_are_all_kept():
    for seed in range(10):
        card = learn(Reference(reference(seed=seed)))
        assert len(card.runs) == 30
        assert not [note for note in card.notes if "set aside" in note]


@given(st.lists(st.floats(-5.0, 1e6), min_size=2, max_size=60))
def test_never_more_than_a_tenth_is_odd_and_all_odd_are_above_the_others(values):
    scores = np.array(values)
    found = odd(scores)
    assert found.sum() <= max(MOST_ODD * len(scores), 0)
    if found.any():
        assert scores[found].min() > scores[~found].max()


def test_copies_of_a_recording_count_once():
    table = reference()
    copies = pd.concat([table, table.iloc[[3, 3]].assign(run_id=["copy1", "copy2"])])
    card = learn(Reference(copies.reset_index(drop=True)))
    assert card.runs["run_id"].tolist() == table["run_id"].tolist()
    assert "copy1, copy2: the same as another recording" in " ".join(card.notes)
