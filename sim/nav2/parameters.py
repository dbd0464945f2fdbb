"""Nav2's parameters that a run may set, by their names in ``nav2_params.yaml``.

A name reads ``<node>.<parameter>``, as in ``controller_server.FollowPath.PathDist.scale``.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

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


PARAMETERS: Mapping[str, TunableParameter] = {
    name: TunableParameter(*row)
    for name, row in yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8")).items()
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
    changed: dict[str, dict[str, Any]] = defaultdict(dict)
    for name, value in given.items():
        setting = PARAMETERS.get(name)
        if setting is None:
            raise RecipeError(f"There is no parameter {name}; there are {', '.join(PARAMETERS)}.")
        changed[setting.part][setting.field] = setting.checked(name, value)
    dwb = Parameters(sim_time=STOCK_SIM_TIME) if stock else Parameters()
    everywhere = AS_SHIPPED if stock else Inflation(cost_scaling=GLOBAL_COST_SCALING)
    return Settings(
        dwb._replace(**changed["dwb"]),
        AS_SHIPPED._replace(**changed["local_inflation"]),
        everywhere._replace(**changed["global_inflation"]),
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
