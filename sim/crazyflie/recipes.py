"""The recipe of a flight: everything that determines it."""

from dataclasses import dataclass
from typing import Literal

from sim.campaigns import Campaign
from sim.testbed import Recipe

Kind = Literal["takeoff", "hover", "waypoint", "eight", "landing"]
Place = tuple[float, float, float, float]  # x, y, z [m], yaw [rad]


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

    @property
    def end(self) -> Place:
        """Where it ends."""
        return self.x, self.y, self.z, self.yaw


@dataclass(frozen=True, slots=True)
class Craft:
    """What differs between Crazyflies, batteries and days."""

    mass: float  # relative to the model, with markers and deck
    centre: tuple[float, float]  # of mass: forward and left [m]
    thrust: tuple[float, ...]  # of each rotor, relative to the model
    imbalance: tuple[float, ...]  # of each rotor: mass times radius [kg m]
    charge: float  # of the battery, as a share of its capacity
    resistance: float  # of the battery [Ohm]
    wind: tuple[float, float]  # forward and left [m/s]
    gust: float  # standard deviation along each axis [m/s]
    unsteady: float  # standard deviation of each rotor's thrust, relative to it


@dataclass(frozen=True, slots=True)
class CrazyflieSession:
    """Conditions that are constant within a session, and differ between sessions."""

    index: int
    craft: Craft
    gains: float  # of all PIDs, relative to the firmware's
    latency_ms: float  # of every node that processes messages
    tracking_m: float  # standard deviation of a tracked position, along each axis
    tracking_rad: float  # the same of an orientation, about each axis
    lost: float  # share of the poses that motion capture loses


@dataclass(frozen=True, slots=True)
class CrazyflieRecipe(Recipe):
    """Everything that determines a flight."""

    session: CrazyflieSession
    legs: tuple[Leg, ...]
    timeout_s: float

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(
            self.seed, len(self.legs), self.storage, self.timeout_s,
            session=self.session.index, noise_per_run=bool(self.noise),
        )  # fmt: skip
