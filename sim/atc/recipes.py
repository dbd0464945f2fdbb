"""What an air traffic run is made from: as ``sim.recipes``, for the second testbed."""

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, Self

import numpy as np

from sim.atc.airspace import AirSpace, Flight, Waypoint
from sim.atc.geodesy import slant_range
from sim.atc.sensors import RADAR_RANGE_M
from sim.atc.traffic import draw_traffic
from sim.middleware.executor import SECOND
from sim.modes import Mode
from sim.seeds import generator, node_generator, sequence

SESSIONS = 3
SETTLING_S = 15.0  # three turns of the radars, before the recording begins

# Branches of the seed: what is drawn on one does not move what is drawn on another.
_SESSION, _BLOCK, _NODE, _ATTACK, _TARGET = range(5)

_LOOK_S = 5  # how often it is looked who is in coverage


@dataclass(frozen=True, slots=True)
class AtcCampaign:
    """What all runs of a campaign have in common."""

    seed: int = 20260101
    flights: int = 10
    duration_s: float = 600.0  # of the recording
    storage: Literal["mcap", "sqlite3"] = "mcap"


@dataclass(frozen=True, slots=True)
class AtcSession:
    """What stays the same for a day and differs from the next."""

    index: int
    wind: tuple[float, float]  # where the air moves to, east and north [m/s]
    range_bias_m: float  # of both radars, as they share an antenna
    azimuth_bias_deg: float
    latency_ms: float  # of every node that processes messages


@dataclass(frozen=True, slots=True)
class AtcRecipe:
    """All that a run is a function of."""

    mode: str
    scenario: Mapping[str, Any]  # the document
    parameters: Mapping[str, Any]  # a value for each of the scenario's
    run: int
    block: int
    seed: int
    session: AtcSession
    flights: tuple[Flight, ...]
    duration_s: float
    storage: Literal["mcap", "sqlite3"]

    def generator(self, node: str) -> np.random.Generator:
        """Return the randomness of one node; the same in every mode of the block."""
        return node_generator(self.seed, _NODE, self.block, node)

    def attack_seed(self) -> int:
        """Return the key of the attack's own, counter-based randomness."""
        return int(sequence(self.seed, _ATTACK, self.block).generate_state(1, np.uint64)[0])

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON knows it."""
        document = asdict(self)
        document["session"]["wind"] = list(self.session.wind)
        document["flights"] = [
            {**flight, "route": list(flight["route"])} for flight in document["flights"]
        ]
        return document

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe that ``to_dict`` gave."""
        session = document["session"]
        flights = (
            Flight(**{**flight, "route": tuple(Waypoint(**point) for point in flight["route"])})
            for flight in document["flights"]
        )
        return cls(
            **{
                **document,
                "session": AtcSession(**{**session, "wind": tuple(session["wind"])}),
                "flights": tuple(flights),
            }
        )


def atc_recipe_for(
    mode: Mode, run: int, campaign: AtcCampaign, parameters: Mapping[str, Any] | None = None
) -> AtcRecipe:
    """Return the recipe of one run of a campaign.

    Parameters
    ----------
    mode, run, campaign
        Which run, of what.
    parameters
        Values of the scenario's parameters, in place of what the block has drawn or the default.

    Raises
    ------
    OracleError
        If there is no room for the campaign's flights.
    """
    session = _draw_session(campaign.seed, run % SESSIONS)
    flights = _draw_flights(campaign, run, session.wind)
    target = _draw_target(campaign, run, flights, session.wind)
    drawn = {"target_icao24": target.icao24, "target_callsign": target.callsign}
    return AtcRecipe(
        mode=mode.id,
        scenario=mode.scenario.document,
        parameters=mode.parameters(drawn, parameters or {}),
        run=run,
        block=run,
        seed=campaign.seed,
        session=session,
        flights=flights,
        duration_s=campaign.duration_s,
        storage=campaign.storage,
    )


@functools.cache  # all modes of a block share it
def _draw_flights(
    campaign: AtcCampaign, block: int, wind: tuple[float, float]
) -> tuple[Flight, ...]:
    rng = generator(campaign.seed, _BLOCK, block)
    return draw_traffic(rng, campaign.flights, SETTLING_S + campaign.duration_s, wind)


@functools.cache
def _draw_target(
    campaign: AtcCampaign, block: int, flights: tuple[Flight, ...], wind: tuple[float, float]
) -> Flight:
    """Draw whom attacks are after: one that is in coverage all the first half of the recording."""
    air = AirSpace(flights, wind)
    covered = set(range(len(flights)))
    begin_s, end_s = round(SETTLING_S), round(SETTLING_S + campaign.duration_s / 2.0)
    for second in range(begin_s, end_s, _LOOK_S):
        air.advance_to(second * SECOND)
        numbers, states = air.in_the_air()
        slant_m = np.array([slant_range(np.hypot(x, y), z) for x, y, z in states[:, :3]])
        covered &= set(numbers[slant_m <= RADAR_RANGE_M].tolist())
    return flights[int(generator(campaign.seed, _TARGET, block).choice(sorted(covered)))]


def _draw_session(seed: int, index: int) -> AtcSession:
    rng = generator(seed, _SESSION, index)
    speed, towards = rng.uniform(0.0, 15.0), rng.uniform(0.0, 2.0 * np.pi)
    return AtcSession(
        index=index,
        wind=(float(speed * np.sin(towards)), float(speed * np.cos(towards))),
        range_bias_m=float(rng.uniform(-30.0, 30.0)),
        azimuth_bias_deg=float(rng.uniform(-0.04, 0.04)),
        latency_ms=float(rng.uniform(5.0, 20.0)),
    )
