"""Draws the flight, the Crazyflie and the weather of a block from the campaign's seed.

Run i of every mode belongs to block i. A flight hovers, flies to points around the room, and ends
with a figure of eight; with a single goal it hovers.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sim.campaigns import Campaign
from sim.crazyflie.recipes import Craft, CrazyflieRecipe, CrazyflieSession, Leg
from sim.seeds import BLOCK, SESSION, generator
from sim.testbed import Mode

REACH_M = 1.0  # of points from the start, along both axes
HEIGHTS_M = (0.5, 1.2)
HOVER_S = 6.0
CRUISE_M_S = 0.5  # mean speed between points
MIN_LEG_M = 0.5


def draw(mode: Mode, run: int, campaign: Campaign, given: Mapping[str, Any]) -> CrazyflieRecipe:
    """Return the recipe of one run of a campaign; the arguments are those of `Testbed.draw`."""
    return CrazyflieRecipe(
        **mode.recipe_fields(run, campaign, {}, given),
        session=_draw_session(campaign.seed, campaign.session_of(run)),
        legs=tuple(_draw_legs(generator(campaign.seed, BLOCK, run), campaign.goals_per_run)),
        timeout_s=campaign.timeout_s,
    )


def _draw_legs(rng: np.random.Generator, goals: int) -> Iterator[Leg]:
    here = Leg("hover", 0.0, 0.0, rng.uniform(*HEIGHTS_M), 0.0, HOVER_S)
    yield here
    for _ in range(goals - 2):
        here = _draw_point(rng, here)
        yield here
    if goals > 1:
        size, seconds = rng.uniform(0.4, 0.8), rng.uniform(9.0, 12.0)
        yield Leg("eight", here.x, here.y, here.z, here.yaw, seconds, size)


def _draw_point(rng: np.random.Generator, here: Leg) -> Leg:
    while True:
        x, y = rng.uniform(-REACH_M, REACH_M, 2).tolist()
        z, yaw = rng.uniform(*HEIGHTS_M), rng.uniform(-0.6, 0.6)
        away = math.dist((x, y, z), (here.x, here.y, here.z))
        if away >= MIN_LEG_M:
            return Leg("waypoint", x, y, z, yaw, 1.0 + away / CRUISE_M_S)


def _draw_session(seed: int, index: int) -> CrazyflieSession:
    """Draw the conditions of a session; see docs/explanation/crazyflie.md for the ranges."""
    rng = generator(seed, SESSION, index)
    speed, towards = rng.uniform(0.0, 0.5), rng.uniform(0.0, 2.0 * math.pi)
    craft = Craft(
        mass=rng.uniform(1.12, 1.18), centre=tuple(rng.uniform(-5e-4, 5e-4, 2).tolist()),
        thrust=tuple(rng.uniform(0.985, 1.015, 4).tolist()),
        imbalance=tuple(rng.uniform(0.0, 4e-9, 4).tolist()), charge=rng.uniform(0.6, 1.0),
        resistance=rng.uniform(0.08, 0.13),
        wind=(speed * math.cos(towards), speed * math.sin(towards)), gust=rng.uniform(0.05, 0.2),
        unsteady=rng.uniform(0.02, 0.04),
    )  # fmt: skip
    return CrazyflieSession(
        index=index, craft=craft, gains=rng.uniform(0.95, 1.05), latency_ms=rng.uniform(2.0, 6.0),
        tracking_m=rng.uniform(2e-4, 8e-4), tracking_rad=rng.uniform(2e-3, 8e-3),
        lost=rng.uniform(0.0, 0.01),
    )  # fmt: skip
