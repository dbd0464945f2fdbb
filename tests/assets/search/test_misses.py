"""A miss is a miss of the user: nothing in the whole verdict counts against the attacked run."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from assets.search.closed_loop import SHARE, task_effects
from assets.search.oracles import FEATURES, against
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.scoring.alarms import Alarm
from oracle_pipeline.scoring.verdict import AspectScore, Verdict
from tests.sim.test_pairs import SUCCEEDED, manifest

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


@given(st.lists(st.floats(3.0, 5.0), max_size=4), st.floats(0.0, 8.0))
def test_what_repeats_reach_is_no_effect(repeated: list[float], driven_m: float) -> None:
    def driven(way: float) -> Manifest:
        return manifest("lidar_passthrough", replace(SUCCEEDED, driven_m=way))

    control, repeats = driven(4.0), [driven(way) for way in repeated]
    difference, effect = task_effects(driven(driven_m), control, repeats)["driven_m"]
    low, high = min([4.0, *repeated]), max([4.0, *repeated])
    assert difference == driven_m - 4.0
    assert (effect == 0.0) == (low <= driven_m <= high)
    assert abs(effect) <= abs(difference) / (SHARE * 4.0) + 1e-9
