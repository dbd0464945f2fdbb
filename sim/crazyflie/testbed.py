"""The third testbed: a Crazyflie that hovers, flies to points, and flies a figure of eight."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.campaigns import Campaign
from sim.crazyflie.recipes import CrazyflieRecipe
from sim.testbed import Mode, Testbed

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun


def _draw(
    mode: Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any]
) -> CrazyflieRecipe:
    from sim.crazyflie.drawing import draw

    return draw(mode, run, campaign, parameters)


def _bring_up(recipe: CrazyflieRecipe, folder: Path) -> "TestbedRun":
    from sim.crazyflie.run import CrazyflieRun

    return CrazyflieRun(recipe, folder)


CRAZYFLIE = Testbed(
    experiments=("cf_normal", "cf_propeller_cut"),
    messages=frozenset({"crazyflie_interfaces", "motion_capture_tracking_interfaces"}),
    recipe=CrazyflieRecipe,
    draw=_draw,
    bring_up=_bring_up,
    made_by="sim.crazyflie.run",
)
