"""The search space: bounds of the scenario, or narrower ones."""

import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from assets.search.attack_space import SearchError
from assets.search.scenario_parameters import distributions, scenario_attacks
from assets.search.search import TrialBudget
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
    assert distributions(mode) == {
        "share": FloatDistribution(0.001, 1.0, log=True),
        "count": IntDistribution(1, 9),
        "on": CategoricalDistribution([False, True]),
    }


def test_a_range_narrows_a_parameter_or_frees_one(mode: Mode) -> None:
    found = distributions(mode, ["share=0.2:0.3", "free=-1:1"])
    assert found["share"] == FloatDistribution(0.2, 0.3)
    assert found["free"] == FloatDistribution(-1.0, 1.0)


def test_a_drawn_parameter_is_varied_only_with_a_range() -> None:
    fake = find_mode("fake_object")
    with pytest.raises(SearchError, match="no parameter to vary"):
        distributions(fake)
    found = distributions(fake, ["radius=0.05:0.3"])
    assert found == {"radius": FloatDistribution(0.05, 0.3)}


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
        distributions(mode, [text])


@given(st.integers(0, 2**31))
def test_every_proposal_is_within_the_bounds(seed: int) -> None:
    (scenario,) = parse_scenarios(SCENARIO, "several.yaml")
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
    values = scenario_attacks(Mode(scenario)).suggest(study.ask()).values
    assert 0.001 <= values["share"] <= 1.0
    assert 1 <= values["count"] <= 9
    assert values["on"] in (False, True)


def test_a_budget_is_trials_or_a_time() -> None:
    assert TrialBudget.parse("200").trials == 200
    assert TrialBudget.parse("30m").seconds == 1800.0
    assert TrialBudget.parse("2h").seconds == 7200.0
    for text in ("", "m", "0", "-5", "1.5h", "10s"):
        with pytest.raises(SearchError, match="expected a budget"):
            TrialBudget.parse(text)
