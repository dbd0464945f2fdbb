"""Nav2's parameters by name: real names, their defaults, and errors."""

import re

import pytest

from sim.campaigns import RecipeError
from sim.nav2.parameters import PARAMETERS, named_values, settings

RADIUS = "local_costmap.inflation_layer.inflation_radius"
# nav2_bringup/params/nav2_params.yaml of Humble, as far as it can be set here.
SHIPPED = {
    "local_costmap.inflation_layer.inflation_radius": 0.55,
    "local_costmap.inflation_layer.cost_scaling_factor": 3.0,
    "global_costmap.inflation_layer.inflation_radius": 0.55,
    "global_costmap.inflation_layer.cost_scaling_factor": 3.0,
    "controller_server.FollowPath.max_vel_x": 0.26,
    "controller_server.FollowPath.max_vel_theta": 1.0,
    "controller_server.FollowPath.acc_lim_x": 2.5,
    "controller_server.FollowPath.decel_lim_x": -2.5,
    "controller_server.FollowPath.acc_lim_theta": 3.2,
    "controller_server.FollowPath.decel_lim_theta": -3.2,
    "controller_server.FollowPath.vx_samples": 20,
    "controller_server.FollowPath.vtheta_samples": 20,
    "controller_server.FollowPath.sim_time": 1.7,
    "controller_server.FollowPath.linear_granularity": 0.05,
    "controller_server.FollowPath.angular_granularity": 0.025,
    "controller_server.FollowPath.xy_goal_tolerance": 0.25,
    "controller_server.FollowPath.trans_stopped_velocity": 0.25,
    "controller_server.FollowPath.RotateToGoal.slowing_factor": 5.0,
    "controller_server.FollowPath.RotateToGoal.scale": 32.0,
    "controller_server.FollowPath.BaseObstacle.scale": 0.02,
    "controller_server.FollowPath.GoalAlign.scale": 24.0,
    "controller_server.FollowPath.PathAlign.scale": 32.0,
    "controller_server.FollowPath.PathDist.scale": 32.0,
    "controller_server.FollowPath.GoalDist.scale": 24.0,
}


def test_stock_values_are_those_that_nav2_ships() -> None:
    assert SHIPPED.keys() == PARAMETERS.keys()
    assert settings(stock=True, given=SHIPPED) == settings(stock=True, given={})


@pytest.mark.parametrize("name", SHIPPED)
def test_every_parameter_reaches_the_settings_alone(name: str) -> None:
    usual, parameter = settings(stock=True, given={}), PARAMETERS[name]
    value = SHIPPED[name] + 1 if isinstance(SHIPPED[name], int) else SHIPPED[name] * 1.1
    changed = settings(stock=True, given={name: value})
    assert getattr(getattr(changed, parameter.part), parameter.field) == pytest.approx(value)
    assert settings(stock=True, given={name: SHIPPED[name]}) == usual


def test_the_end_of_a_name_sets_all_that_end_so() -> None:
    assert named_values(["inflation_radius=0.7"]) == {
        "global_costmap.inflation_layer.inflation_radius": 0.7,
        "local_costmap.inflation_layer.inflation_radius": 0.7,
    }
    assert named_values(["local_costmap.inflation_layer.inflation_radius=0.7"]) == {RADIUS: 0.7}
    assert named_values(["PathDist.scale=20", "vx_samples=30"]) == {
        "controller_server.FollowPath.PathDist.scale": 20.0,
        "controller_server.FollowPath.vx_samples": 30,
    }


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("radius=0.7", "There is no parameter 'radius'; there are local_costmap.inflation_layer"),
        ("=0.7", "There is no parameter ''"),
        ("inflation_radius", "expected NAME=NUMBER, found 'inflation_radius'"),
        ("inflation_radius=wide", "expected NAME=NUMBER"),
        ("inflation_radius=nan", "expected 0.05 to 3, found nan"),
        ("inflation_radius=30", "expected 0.05 to 3, found 30"),
        ("vx_samples=2.5", "expected a whole number, found 2.5"),
    ],
)
def test_errors_state_the_expected_value(word: str, reason: str) -> None:
    with pytest.raises(RecipeError, match=re.escape(reason)):
        named_values([word])


def test_a_recipe_with_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(RecipeError, match=re.escape("no parameter FollowPath.speed")):
        settings(stock=False, given={"FollowPath.speed": 1.0})
