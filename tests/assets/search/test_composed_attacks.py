"""Composed attacks: proposals are valid scenarios on existing topics."""

from pathlib import Path

import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st
from optuna.distributions import FloatDistribution

from assets.search.attack_space import SearchError
from assets.search.composed_attacks import ALTERATIONS, composed_attacks
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.scenario import parse_scenarios

THERE = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/range_ella": "sensor_msgs/msg/Range",
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/map": "std_msgs/msg/String",
}
TOPICS = ["/scan", "/odom", "/imu", "/range_ella", "/cmd_vel"]
SPACE = composed_attacks(TOPICS, [], THERE, allow_actuation=True)


@given(st.integers(0, 2**31))
def test_every_composed_attack_is_a_scenario_that_compiles(seed: int) -> None:
    import yaml

    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
    attack = SPACE.suggest(study.ask())
    text = yaml.safe_dump(dict(attack.document)).encode()
    (scenario,) = parse_scenarios(text, "composed.yaml")
    program = compile_scenario(scenario, allow_actuation=True)
    assert program.is_in_place
    assert program.input_topic == attack.values["topic"]
    assert attack.values["operator"] in ALTERATIONS


@pytest.mark.parametrize("name", ["add", "scale", "drift"])
def test_small_changes_are_proposed_as_often_as_large_ones_in_both_directions(name: str) -> None:
    alteration = ALTERATIONS[name]
    bounds = alteration.values
    assert isinstance(bounds, FloatDistribution)
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    values = [alteration.suggest(study.ask()) for _ in range(300)]
    middle = (bounds.low * bounds.high) ** 0.5
    assert 0.4 < sum(abs(value) < middle for value in values) / 300 < 0.6
    assert 0.4 < sum(value < 0.0 for value in values) / 300 < 0.6


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        ("/lidar", "There is no topic /lidar; there are /cmd_vel"),
        ("/cmd_vel", "may move the robot; allow it with --allow-actuation"),
        ("/map", "has no number that could be altered"),
    ],
)
def test_a_topic_that_cannot_be_altered_is_an_error(topic: str, reason: str) -> None:
    with pytest.raises(SearchError, match=reason):
        composed_attacks([topic], [], THERE)


def test_the_error_for_an_unknown_operator_lists_the_known_ones() -> None:
    with pytest.raises(SearchError, match="no operator vanish; there are add, scale"):
        composed_attacks(["/scan"], ["vanish"], THERE)


def test_an_operator_that_needs_no_number_is_not_refused_on_any_topic(tmp_path: Path) -> None:
    space = composed_attacks(["/map"], ["drop", "freeze"], THERE)
    study = optuna.create_study()
    assert space.suggest(study.ask()).values["topic"] == "/map"
