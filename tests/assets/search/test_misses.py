"""A miss is a miss of the user: nothing in the whole verdict is held against the attacked run."""

from dataclasses import replace
from typing import Any

import pytest

from assets.search.closed_loop import FEATURES, against
from oracle_pipeline.scoring.alarms import Alarm
from oracle_pipeline.scoring.verdict import AspectScore, Verdict

FAR = 0.05
NORMAL = Verdict("run", "normal", p_value=0.5, score=0.1)


def test_nothing_is_held_against_a_normal_run() -> None:
    assert against(NORMAL, FAR) == set()


@pytest.mark.parametrize(
    ("part", "held"),
    [
        ({"p_value": FAR}, {FEATURES}),
        ({"p_value": None}, {FEATURES}),
        ({"contract": ("Topic /scan is gone.",)}, {"contract: Topic /scan is gone."}),
        ({"alarms": (Alarm(5.0, 9.0, 3.0),)}, {"alarms"}),
        ({"aspects": {"misbehaviour": AspectScore(FAR, FAR, 4.0)}}, {"misbehaviour"}),
        ({"aspects": {"tampering": AspectScore(0.4, 0.4, 0.1)}}, set()),
    ],
)
def test_each_part_of_a_verdict_is_held_against_a_run(part: dict[str, Any], held: set[str]) -> None:
    assert against(replace(NORMAL, **part), FAR) == held
