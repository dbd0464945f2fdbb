"""The recipe of an air traffic run: everything that determines it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from sim.atc.airspace import Flight, Waypoint
from sim.campaigns import Campaign, Storage
from sim.seeds import attack_seed, node_generator

SETTLING_S = 15.0  # three turns of the radars, before the recording begins

# Branches of the seed: draws from one do not affect draws from another.
SESSION, BLOCK, NODE, ATTACK, TARGET = range(5)


@dataclass(frozen=True, slots=True)
class AtcSession:
    """Conditions that are constant within a session, and differ between sessions."""

    index: int
    wind: tuple[float, float]  # velocity of the air, east and north [m/s]
    range_bias_m: float  # of both radars, as they share an antenna
    azimuth_bias_deg: float
    latency_ms: float  # of every node that processes messages


@dataclass(frozen=True, slots=True)
class AtcRecipe:
    """Everything that determines a run."""

    mode: str
    scenario: Mapping[str, Any]  # the document
    parameters: Mapping[str, Any]  # a value for each of the scenario's
    run: int
    block: int
    seed: int
    session: AtcSession
    flights: tuple[Flight, ...]
    duration_s: float
    storage: Storage
    noise: str  # `Mode.noise`

    def generator(self, node: str) -> np.random.Generator:
        """Return the generator of one node; equal in all runs of a block that share their noise."""
        return node_generator(self.seed, NODE, self.block, self.noise + node)

    def attack_seed(self) -> int:
        """Return the key of the attack's counter-based generator."""
        return attack_seed(self.seed, ATTACK, self.block)

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON values."""
        document = asdict(self)
        document["session"]["wind"] = list(self.session.wind)
        document["flights"] = [
            {**flight, "route": list(flight["route"])} for flight in document["flights"]
        ]
        return document

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe from the result of ``to_dict``."""
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

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(
            self.seed, storage=self.storage, timeout_s=self.duration_s,
            session=self.session.index, noise_per_run=bool(self.noise),
        )  # fmt: skip
