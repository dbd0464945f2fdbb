"""Comparing sets: pairs where blocks are the same, resolution, and notes on limitations."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.comparison.measurements import resolved_values
from oracle_pipeline.comparison.permutation import MatchedPairs, TwoSamples
from oracle_pipeline.comparison.set_comparison import ComparisonError, compare, fewest
from oracle_pipeline.comparison.texts import as_markdown, as_text
from oracle_pipeline.datasets import Fields
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.parameters import ReportedParameters
from oracle_pipeline.scoring.reference import Reference


def reference(values: Any, *, mode: str = "m", first_block: int = 0, session: int = 0) -> Reference:
    n = len(values)
    table = pd.DataFrame(
        {
            "run_id": [f"{mode}|{first_block + i}" for i in range(n)],
            "mode": mode,
            "block": np.arange(n) + first_block,
            "session": session,
            "drive.path": np.asarray(values, dtype=np.float64),
        }
    )
    table.attrs["fields"] = Fields({"drive.path": {"unit": "m", "floor": "0.5"}})
    return Reference(table)


def test_the_comment_says_what_changed_by_how_much_and_what_did_not() -> None:
    first = reference(np.arange(8.0))
    second = reference(np.arange(8.0) + 20.0)
    for each, steady in ((first, [1.0, 2.0]), (second, [2.0, 1.0])):
        each.table["steady.value"] = np.tile(steady, 4)
        each.table["odd`<b>|name.value"] = each.table["drive.path"]
    told = as_markdown(compare(first, second), ["https://example.org/film.gif"])
    title, *lines = told.splitlines()
    assert title.startswith("### The behaviour changed: `")
    assert "went from 3.5 to 23.5 m (p = 0.016), and 1 more feature changed" in title
    assert "| `drive.path` | 3.5 m | 23.5 m | +20 (+20 to +20) | 0.016 |" in lines
    assert "**Did not change:** steady (1)." in lines
    assert lines[-1] == "https://example.org/film.gif"
    assert "`odd?<b>?name.value`" in told  # inside code, no markup of a name counts


def test_signals_are_compared_and_come_after_known_features_and_before_bytes() -> None:
    rng = np.random.default_rng(0)
    first, second = reference(np.arange(8.0)), reference(np.arange(8.0))
    signal = "signals./joints/error[0].std"
    for each, level in ((first, 0.0), (second, 1.0)):
        each.table[signal] = level + rng.normal(size=8) / 10.0
    (only,) = compare(first, second).differences
    assert (only.feature, only.family) == (signal, "signals")
    second.table["drive.path"] += 20.0 + rng.normal(size=8)  # less certain than the signal
    size = "generic.byte_rate"
    first.table[size], second.table[size] = rng.normal(0.0, 1.0, 8), rng.normal(900.0, 1.0, 8)
    found = [each.feature for each in compare(first, second).differences]
    assert found == ["drive.path", signal, size]


def test_a_difference_far_below_the_spread_of_a_signal_does_not_count() -> None:
    first, second = reference(np.arange(8.0)), reference(np.arange(8.0))
    for each, more in ((first, 0.0), (second, 1e-3)):
        each.table["signals./joints/effort[0].mean"] = np.arange(8.0) + more
    assert compare(first, second).outcome == "same"


def test_the_level_of_a_setting_such_as_the_date_is_no_behaviour() -> None:
    first, second = reference(np.arange(8.0)), reference(np.arange(8.0))
    for each, day in ((first, 0.0), (second, 9.0)):
        each.table["signals./gps/day.mean"] = day + np.arange(8.0) / 8.0
        each.table["signals./gps/day.std"] = 1e-4
    assert compare(first, second).outcome == "same"


def test_a_set_does_not_differ_from_itself() -> None:
    normal = reference(np.arange(8.0))
    assert compare(normal, normal).outcome == "same"
    assert as_markdown(compare(normal, normal)).startswith("### NO DIFFERENCE in 1 features")
    assert as_text(compare(normal, normal)).splitlines()[-1].startswith("Next: ")


def test_equal_blocks_are_compared_in_pairs_in_any_order() -> None:
    goals = np.array([3.0, 40.0, 12.0, 7.0, 25.0, 18.0])  # blocks differ far more than the sets
    first, second = reference(goals), reference(goals + 1.0, mode="other")
    shuffled = Reference(second.table.sample(frac=1.0, random_state=3))
    for other in (second, shuffled):
        comparison = compare(first, other)
        assert comparison.pairs == 6
        assert comparison.outcome == "different"
        (difference,) = comparison.differences
        assert (difference.shift, difference.effect, difference.unit) == (1.0, 1.0, "m")
    assert compare(first, reference(goals + 1.0, first_block=6)).outcome == "same"


def test_recordings_without_a_manifest_have_no_partners() -> None:
    values = np.arange(6.0)
    comparison = compare(reference(values, first_block=-6), reference(values, first_block=-6))
    assert comparison.pairs == 0


def three_robots(values: np.ndarray) -> Reference:
    """Return a recording of three equal robots for each value."""
    table = reference(np.repeat(values, 3)).table
    recording, robot = np.divmod(np.arange(len(table)), 3)
    names = [f"bag{i}#robot{k}" for i, k in zip(recording, robot, strict=True)]
    return Reference(table.assign(run_id=names, block=-1 - recording))


def test_robots_of_one_recording_count_as_one_recording() -> None:
    comparison = compare(three_robots(np.arange(3.0)), three_robots(np.arange(3.0) + 100.0))
    assert comparison.recordings == (3, 3)
    assert comparison.lowest_p == 2 / math.comb(6, 3)  # too large for a verdict at 5 %
    assert comparison.outcome == "unsupported"
    assert sum("9 robots in 3 recordings" in note for note in comparison.notes) == 2


def test_equal_robots_of_a_recording_make_no_interval_shorter_and_no_p_value_smaller() -> None:
    first, second = np.arange(7.0), np.arange(7.0) + 9.0
    (one,) = compare(
        reference(first, first_block=-9), reference(second, first_block=-9)
    ).differences
    (three,) = compare(three_robots(first), three_robots(second)).differences
    assert (three.low, three.high, three.p_value) == (one.low, one.high, one.p_value)


def test_a_difference_below_the_resolution_does_not_count() -> None:
    table = reference([0.0, 0.02, 0.04, 2.0]).table
    (steps,) = resolved_values([table[["drive.path"]]], table)
    assert steps[:, 0].tolist() == [0.0, 0.0, 0.0, 20.0]


@pytest.mark.parametrize(
    ("seen", "element"),
    [
        ({"/map": ("nav_msgs/msg/OccupancyGrid", (), None)}, "interface.topic /map"),
        ({"/map": ("nav_msgs/msg/OccupancyGrid", ("reliable, volatile",), 1.0)}, "QoS reliable"),
    ],
)
def test_a_topic_that_one_set_lacks_is_a_difference(seen: Any, element: str) -> None:
    sets = [
        Reference(
            reference(np.arange(5.0), first_block=-9).table,
            observations=tuple(Observation(topics, None) for _ in range(5)),
        )
        for topics in ({}, seen)
    ]
    features = [each.feature for each in compare(*sets).differences]
    assert any(element in feature for feature in features)


def told(values: dict[str, float | str]) -> ReportedParameters:
    return ReportedParameters(values, frozenset())


@pytest.mark.parametrize(
    ("before", "after", "feature"),
    [
        ({"parameters": told({"/dwb speed": 0.26})}, {"parameters": told({"/dwb speed": 0.23})},
         "parameter./dwb speed"),
        ({"parameters": told({"/dwb frame": "map"})}, {"parameters": told({"/dwb frame": "odom"})},
         "interface.parameter /dwb frame = map"),
        ({"entropies": {"/costmap": 3.6}}, {"entropies": {"/costmap": 3.9}}, "payload./costmap"),
    ],
)  # fmt: skip
def test_what_nodes_are_told_and_what_topics_carry_is_compared(
    before: Any, after: Any, feature: str
) -> None:
    sets = [
        Reference(
            reference(np.arange(5.0), first_block=-9).table,
            observations=(Observation({}, None, **of),) * 5,
        )
        for of in (before, after)
    ]
    assert feature in [each.feature for each in compare(*sets).differences]


@pytest.mark.parametrize("paired", [False, True])
def test_the_stated_number_of_recordings_is_the_smallest_sufficient_one(*, paired: bool) -> None:
    def lowest_p(n: int) -> float:
        rows = np.arange(n, dtype=np.float64)[:, None]
        return (MatchedPairs if paired else TwoSamples)(rows, rows + 1.0).lowest_p

    for level in (0.1, 0.05, 0.01):
        n = fewest(level, paired=paired)
        assert lowest_p(n) <= level < lowest_p(n - 1)


def test_a_note_warns_of_sets_with_one_session_each() -> None:
    comparison = compare(reference(np.arange(6.0)), reference(np.arange(6.0), session=1))
    assert any("may be due to the session" in note for note in comparison.notes)


def test_sets_without_varying_features_are_an_error() -> None:
    with pytest.raises(ComparisonError, match="No feature varies"):
        compare(reference(np.zeros(6)), reference(np.zeros(6)))
    with pytest.raises(ComparisonError, match="1 recording"):
        compare(reference(np.zeros(6)), reference(np.zeros(1)))
    with pytest.raises(ComparisonError, match="1 recording"):
        compare(three_robots(np.arange(6.0)), three_robots(np.zeros(1)))
