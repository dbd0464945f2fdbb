"""The recipe of a run of the arm: everything that determines it."""

from dataclasses import dataclass

from oracle_pipeline.bags.manifest import Pose
from sim.campaigns import Campaign
from sim.testbed import Recipe


@dataclass(frozen=True, slots=True)
class ArmSession:
    """Conditions that are constant within a session, and differ between sessions."""

    index: int
    mass: float  # of the object [kg]
    friction: float  # between fingers and object
    gains: float  # of the servos, relative to the model
    joint_friction: tuple[float, ...]  # of each joint [N m]
    encoder: tuple[float, ...]  # error of each joint's encoder [rad]
    latency_ms: float  # of every node that processes messages
    camera: tuple[float, float]  # error of all poses that the detector measures [m]
    camera_m: float  # standard deviation of each
    force_n: float  # standard deviation of a force that the sensor measures, along each axis
    torque_nm: float  # the same of a torque


@dataclass(frozen=True, slots=True)
class ArmRecipe(Recipe):
    """Everything that determines a run."""

    session: ArmSession
    start: Pose  # of the object
    places: tuple[Pose, ...]  # to which it is brought, one after another
    obstacle: Pose  # foot of a post
    timeout_s: float

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(
            self.seed, len(self.places), self.storage, self.timeout_s,
            session=self.session.index, noise_per_run=bool(self.noise),
        )  # fmt: skip
