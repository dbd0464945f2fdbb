"""The second testbed: flights, radars, ADS-B and the controller's display."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.atc.recipes import AtcRecipe
from sim.campaigns import Campaign
from sim.testbed import Mode, Testbed

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun


def _draw(mode: Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any]) -> AtcRecipe:
    from sim.atc.drawing import draw

    return draw(mode, run, campaign, parameters)


def _bring_up(recipe: AtcRecipe, folder: Path) -> "TestbedRun":
    from sim.atc.run import AtcRun

    return AtcRun(recipe, folder)


AIR_TRAFFIC_CONTROL = Testbed(
    experiments=(
        "atc_normal",
        "atc_delete_by_id",
        "atc_delete_timer_callsign",
        "atc_deadzone",
        "atc_ghost_static",
        "atc_ghost_following",
        "atc_altitude_decrease",
        "atc_gps_alteration",
        "atc_follow_closest",
    ),
    messages=frozenset({"atc_msgs"}),
    recipe=AtcRecipe,
    draw=_draw,
    bring_up=_bring_up,
    made_by="sim.atc.run",
)
