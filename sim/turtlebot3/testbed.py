"""The first testbed: a TurtleBot3 with Nav2 in MuJoCo, on patrol."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.campaigns import Campaign
from sim.testbed import Mode, Testbed
from sim.turtlebot3.recipes import TurtleBot3Recipe

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun


def _draw(
    mode: Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any]
) -> TurtleBot3Recipe:
    from sim.turtlebot3.drawing import draw  # maps and planner take long to import

    return draw(mode, run, campaign, parameters)


def _bring_up(recipe: TurtleBot3Recipe, folder: Path) -> "TestbedRun":
    from sim.turtlebot3.run import TurtleBot3Run  # MuJoCo takes long to import

    return TurtleBot3Run(recipe, folder)


TURTLEBOT3 = Testbed(
    experiments=(  # of the thesis
        "lidar_passthrough",
        "lidar_passthrough_odom",
        "fake_object",
        "random_noise",
        "delayed_passthrough",
        "delayed_fakeobject",
    ),
    hard_negatives={
        "benign_median": {},
        "benign_noise": {},
        "benign_drop": {},
        "benign_obstacle": {"obstacle": True},
        "benign_slow": {"speed": 0.6},
    },
    recipe=TurtleBot3Recipe,
    draw=_draw,
    bring_up=_bring_up,
    made_by="sim.turtlebot3.run",
)
