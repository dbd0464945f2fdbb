"""The recipe of an air traffic run: everything that determines it."""

from dataclasses import dataclass

from sim.atc.airspace import Flight
from sim.campaigns import Campaign
from sim.testbed import Recipe

SETTLING_S = 15.0  # three turns of the radars, before the recording begins

TARGET = 4  # branch of the seed


@dataclass(frozen=True, slots=True)
class AtcSession:
    """Conditions that are constant within a session, and differ between sessions."""

    index: int
    wind: tuple[float, float]  # velocity of the air, east and north [m/s]
    range_bias_m: float  # of both radars, as they share an antenna
    azimuth_bias_deg: float
    latency_ms: float  # of every node that processes messages


@dataclass(frozen=True, slots=True)
class AtcRecipe(Recipe):
    """Everything that determines a run."""

    session: AtcSession
    flights: tuple[Flight, ...]
    duration_s: float

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(
            self.seed, storage=self.storage, timeout_s=self.duration_s,
            session=self.session.index, noise_per_run=bool(self.noise),
        )  # fmt: skip
