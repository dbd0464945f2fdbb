"""Nav2's parameters that a run may set, by their names in ``nav2_params.yaml``.

A name reads ``<node>.<parameter>``, as in ``controller_server.FollowPath.PathDist.scale``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from sim.campaigns import RecipeError
from sim.nav2.dwb_sampling import STOCK_SIM_TIME, Parameters
from sim.nav2.inflation import AS_SHIPPED, GLOBAL_COST_SCALING, Inflation


@dataclass(frozen=True, slots=True)
class Settings:
    """The values of all parameters that may be set."""

    dwb: Parameters
    local_inflation: Inflation
    global_inflation: Inflation


class TunableParameter(NamedTuple):
    """One parameter: the field with its value, and its bounds."""

    part: str  # field of `Settings`
    field: str  # of that
    low: float
    high: float

    def checked(self, name: str, value: float) -> float:
        """Return a value converted to the parameter's type.

        Raises
        ------
        RecipeError
            It cannot have that value; the text begins with `name`.
        """
        if not self.low <= value <= self.high:
            raise RecipeError(f"{name}: expected {self.low:g} to {self.high:g}, found {value:g}.")
        if not isinstance(self.low, int):
            return value
        if value != int(value):
            raise RecipeError(f"{name}: expected a whole number, found {value:g}.")
        return int(value)


_DWB, _LOCAL, _GLOBAL = "dwb", "local_inflation", "global_inflation"

PARAMETERS: Mapping[str, TunableParameter] = {
    **{
        f"{costmap}.inflation_layer.{name}": TunableParameter(part, field, low, high)
        for costmap, part in (("local_costmap", _LOCAL), ("global_costmap", _GLOBAL))
        for name, field, low, high in (
            ("inflation_radius", "radius", 0.05, 3.0),
            ("cost_scaling_factor", "cost_scaling", 0.1, 100.0),
        )
    },
    **{
        f"controller_server.FollowPath.{name}": TunableParameter(_DWB, field, low, high)
        for name, field, low, high in (
            ("max_vel_x", "max_vel_x", 0.01, 2.0),
            ("max_vel_theta", "max_vel_theta", 0.01, 5.0),
            ("acc_lim_x", "acc_lim_x", 0.01, 10.0),
            ("decel_lim_x", "decel_lim_x", -10.0, -0.01),
            ("acc_lim_theta", "acc_lim_theta", 0.01, 10.0),
            ("decel_lim_theta", "decel_lim_theta", -10.0, -0.01),
            ("vx_samples", "vx_samples", 2, 100),
            ("vtheta_samples", "vtheta_samples", 2, 100),
            ("sim_time", "sim_time", 0.1, 5.0),
            ("linear_granularity", "linear_granularity", 0.005, 0.5),
            ("angular_granularity", "angular_granularity", 0.005, 0.5),
            ("xy_goal_tolerance", "xy_goal_tolerance", 0.01, 1.0),
            ("trans_stopped_velocity", "trans_stopped_velocity", 0.01, 1.0),
            ("RotateToGoal.slowing_factor", "slowing_factor", 0.0, 100.0),
            ("RotateToGoal.scale", "rotate_to_goal_scale", 0.0, 1000.0),
            ("BaseObstacle.scale", "base_obstacle_scale", 0.0, 1000.0),
            ("GoalAlign.scale", "goal_align_scale", 0.0, 1000.0),
            ("PathAlign.scale", "path_align_scale", 0.0, 1000.0),
            ("PathDist.scale", "path_dist_scale", 0.0, 1000.0),
            ("GoalDist.scale", "goal_dist_scale", 0.0, 1000.0),
        )
    },
}


def of_node(node: str) -> dict[str, TunableParameter]:
    """Return the parameters of a node by their names there."""
    return {
        name.removeprefix(f"{node}."): setting
        for name, setting in PARAMETERS.items()
        if name.startswith(f"{node}.")
    }


def settings(*, stock: bool, given: Mapping[str, float]) -> Settings:
    """Return the values of all parameters.

    Parameters
    ----------
    stock
        Nav2's default values instead of those tuned to narrow gaps.
    given
        Values to use instead, by the full names of `PARAMETERS`.

    Raises
    ------
    RecipeError
        If there is no such parameter, or it cannot have that value.
    """
    changed: dict[str, dict[str, Any]] = {_DWB: {}, _LOCAL: {}, _GLOBAL: {}}
    for name, value in given.items():
        setting = PARAMETERS.get(name)
        if setting is None:
            raise RecipeError(f"There is no parameter {name}; there are {', '.join(PARAMETERS)}.")
        changed[setting.part][setting.field] = setting.checked(name, value)
    dwb = Parameters(sim_time=STOCK_SIM_TIME) if stock else Parameters()
    everywhere = AS_SHIPPED if stock else Inflation(cost_scaling=GLOBAL_COST_SCALING)
    return Settings(
        dwb._replace(**changed[_DWB]),
        AS_SHIPPED._replace(**changed[_LOCAL]),
        everywhere._replace(**changed[_GLOBAL]),
    )


def named_values(words: Sequence[str]) -> dict[str, float]:
    """Return values by full name; the end of a name selects all parameters that end with it.

    Parameters
    ----------
    words
        As ``inflation_radius=0.7``, which sets that of both costmaps, or
        ``FollowPath.PathDist.scale=20``.

    Raises
    ------
    RecipeError
        If one cannot be read, there is no such parameter, or it cannot have that value.
    """
    found: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        meant = [known for known in PARAMETERS if f".{known}".endswith(f".{name}")]
        if not name or not meant:
            raise RecipeError(f"There is no parameter {name!r}; there are {', '.join(PARAMETERS)}.")
        try:
            value = float(text)
        except ValueError as error:
            raise RecipeError(f"{name}: expected NAME=NUMBER, found {word!r}.") from error
        found |= {known: PARAMETERS[known].checked(known, value) for known in meant}
    return dict(sorted(found.items()))
