"""What an air traffic run is made from: as `sim.recipes`, for the second testbed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, Self

import numpy as np

from sim.atc.airspace import Flight, Waypoint
from sim.atc.traffic import draw_traffic
from sim.seeds import generator, node_generator

SESSIONS = 3
SETTLING_S = 15.0  # three turns of the radars, before the recording begins

# Branches of the seed: what is drawn on one does not move what is drawn on another.
_SESSION, _BLOCK, _NODE = range(3)


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
    """All that a run is a function of, besides what its mode does."""

    mode: str
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


def atc_recipe_for(mode: str, run: int, campaign: AtcCampaign) -> AtcRecipe:
    """Return the recipe of one run of a campaign.

    Raises
    ------
    OracleError
        If there is no room for the campaign's flights.
    """
    session = _draw_session(campaign.seed, run % SESSIONS)
    rng = generator(campaign.seed, _BLOCK, run)
    return AtcRecipe(
        mode=mode,
        run=run,
        block=run,
        seed=campaign.seed,
        session=session,
        flights=draw_traffic(rng, campaign.flights, SETTLING_S + campaign.duration_s, session.wind),
        duration_s=campaign.duration_s,
        storage=campaign.storage,
    )


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
