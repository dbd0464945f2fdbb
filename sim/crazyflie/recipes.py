"""The recipe of a flight: everything that determines it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

from sim.campaigns import Campaign
from sim.crazyflie.world import Craft
from sim.testbed import Recipe

Kind = Literal["hover", "waypoint", "eight"]


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a flight, and where it ends."""

    kind: Kind
    x: float  # forward of the start [m]
    y: float  # left of it [m]
    z: float  # above the floor [m]
    yaw: float  # [rad]
    seconds: float  # that it is to take
    size: float = 0.0  # of the figure of eight: half its length [m]


@dataclass(frozen=True, slots=True)
class CrazyflieSession:
    """Conditions that are constant within a session, and differ between sessions."""

    index: int
    craft: Craft
    gains: float  # of all PIDs, relative to the firmware's
    latency_ms: float  # of every node that processes messages
    jitter_ms: float  # mean of the delay added to it
    tracking_m: float  # standard deviation of a tracked position, along each axis
    tracking_rad: float  # the same of an orientation, about each axis
    lost: float  # share of the poses that motion capture loses


@dataclass(frozen=True, slots=True)
class CrazyflieRecipe(Recipe):
    """Everything that determines a flight."""

    session: CrazyflieSession
    legs: tuple[Leg, ...]
    timeout_s: float

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe from the result of ``to_dict``."""
        session = document["session"]
        craft: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in session["craft"].items()
        }
        return cls(
            **{
                **document,
                "session": CrazyflieSession(**{**session, "craft": Craft(**craft)}),
                "legs": tuple(Leg(**leg) for leg in document["legs"]),
            }
        )

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(
            self.seed, len(self.legs), self.storage, self.timeout_s,
            session=self.session.index, noise_per_run=bool(self.noise),
        )  # fmt: skip
