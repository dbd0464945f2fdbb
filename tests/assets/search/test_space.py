"""The search space: bounds of the scenario, or narrower ones."""

import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st

from assets.search.space import Dimension, SearchError, search_space
from assets.search.study import Budget
from sim.fuzzing.scenario import parse_scenarios
from sim.modes import find_mode
from sim.testbed import Mode

SCENARIO = b"""
schema: mutant/v1
id: several
title: Several kinds of parameters
label: malicious
main: {type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}
parameters:
  share: {type: float, default: 0.5, min: 0.001, max: 1.0}
  count: {type: int, default: 2, min: 1, max: 9}
  on: {type: bool, default: true}
  free: {type: float, default: 0.5}
transform:
  actions:
    - name: noise
      do:
        - drift: {field: ranges, rate: p.share}
"""


@pytest.fixture
def mode() -> Mode:
    (scenario,) = parse_scenarios(SCENARIO, "several.yaml")
    return Mode(scenario)


def test_numbers_with_bounds_and_booleans_are_varied(mode: Mode) -> None:
    space = {each.name: each for each in search_space(mode)}
    assert set(space) == {"share", "count", "on"}
    assert space["share"].is_logarithmic
    assert not space["count"].is_logarithmic


def test_a_range_narrows_a_parameter_or_frees_one(mode: Mode) -> None:
    space = {each.name: each for each in search_space(mode, ["share=0.2:0.3", "free=-1:1"])}
    assert (space["share"].low, space["share"].high) == (0.2, 0.3)
    assert (space["free"].low, space["free"].high) == (-1.0, 1.0)


def test_a_drawn_parameter_is_varied_only_with_a_range() -> None:
    fake = find_mode("fake_object")
    with pytest.raises(SearchError, match="no parameter to vary"):
        search_space(fake)
    (radius,) = search_space(fake, ["radius=0.05:0.3"])
    assert radius == Dimension("radius", 0.05, 0.3, "float")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("share", "expected NAME=LOW:HIGH"),
        ("share=0.1:2", "expected bounds within 0.001 to 1"),
        ("share=0.3:0.2", "expected bounds"),
        ("size=0:1", "no parameter size; it has share, count"),
    ],
)
def test_the_error_for_an_invalid_range_states_the_valid_one(
    mode: Mode, text: str, reason: str
) -> None:
    with pytest.raises(SearchError, match=reason):
        search_space(mode, [text])


@given(st.integers(0, 2**31))
def test_every_proposal_is_within_the_bounds(seed: int) -> None:
    (scenario,) = parse_scenarios(SCENARIO, "several.yaml")
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
    trial = study.ask()
    for dimension in search_space(Mode(scenario)):
        assert dimension.low <= dimension.suggest(trial) <= dimension.high


def test_a_budget_is_trials_or_a_time() -> None:
    assert Budget.parse("200").trials == 200
    assert Budget.parse("30m").seconds == 1800.0
    assert Budget.parse("2h").seconds == 7200.0
    for text in ("", "m", "0", "-5", "1.5h", "10s"):
        with pytest.raises(SearchError, match="expected a budget"):
            Budget.parse(text)
