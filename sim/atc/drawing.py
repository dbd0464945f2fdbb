"""Draws the weather, flights and target of an air traffic run from the campaign's seed.

Run i of every mode belongs to block i, and has the same weather, flights and target.
"""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from sim.atc.airspace import AirSpace, Flight
from sim.atc.geodesy import slant_range
from sim.atc.recipes import SETTLING_S, TARGET, AtcRecipe, AtcSession
from sim.atc.sensors import RADAR_RANGE_M
from sim.atc.traffic import draw_traffic
from sim.campaigns import Campaign
from sim.middleware.executor import SECOND
from sim.seeds import BLOCK, SESSION, generator
from sim.testbed import Mode

FLIGHTS = 10  # of a run

_LOOK_S = 5  # interval at which coverage is checked
_COVERED_S = 300.0  # for which a target stays in coverage, in recordings of at least twice that


def draw(mode: Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any]) -> AtcRecipe:
    """Return the recipe of one run of a campaign.

    Parameters
    ----------
    mode, run, campaign
        Mode, number and campaign of the run.
    parameters
        Values of the scenario's parameters, in place of what the block has drawn or the default.

    Raises
    ------
    OracleError
        If there is no room for the campaign's flights.
    """
    session = _draw_session(campaign.seed, campaign.session_of(run))
    flights = _draw_flights(campaign, run, session.wind)
    target = _draw_target(campaign, run, flights, session.wind)
    drawn = {"target_icao24": target.icao24, "target_callsign": target.callsign}
    return AtcRecipe(
        **mode.recipe_fields(run, campaign, drawn, parameters),
        session=session,
        flights=flights,
        duration_s=campaign.timeout_s,
    )


@functools.cache  # all modes of a block share it
def _draw_flights(campaign: Campaign, block: int, wind: tuple[float, float]) -> tuple[Flight, ...]:
    rng = generator(campaign.seed, BLOCK, block)
    return draw_traffic(rng, FLIGHTS, SETTLING_S + campaign.timeout_s, wind)


@functools.cache
def _draw_target(
    campaign: Campaign, block: int, flights: tuple[Flight, ...], wind: tuple[float, float]
) -> Flight:
    """Draw the target of attacks: a flight in coverage during the first minutes, at most half."""
    air = AirSpace(flights, wind)
    covered = set(range(len(flights)))
    begin_s = round(SETTLING_S)
    end_s = round(SETTLING_S + min(campaign.timeout_s / 2.0, _COVERED_S))
    for second in range(begin_s, end_s, _LOOK_S):
        air.advance_to(second * SECOND)
        numbers, states = air.in_the_air()
        slant_m = np.array([slant_range(np.hypot(x, y), z) for x, y, z in states[:, :3]])
        covered &= set(numbers[slant_m <= RADAR_RANGE_M].tolist())
    return flights[int(generator(campaign.seed, TARGET, block).choice(sorted(covered)))]


def _draw_session(seed: int, index: int) -> AtcSession:
    rng = generator(seed, SESSION, index)
    speed, towards = rng.uniform(0.0, 15.0), rng.uniform(0.0, 2.0 * np.pi)
    return AtcSession(
        index=index,
        wind=(float(speed * np.sin(towards)), float(speed * np.cos(towards))),
        range_bias_m=float(rng.uniform(-30.0, 30.0)),
        azimuth_bias_deg=float(rng.uniform(-0.04, 0.04)),
        latency_ms=float(rng.uniform(5.0, 20.0)),
    )
