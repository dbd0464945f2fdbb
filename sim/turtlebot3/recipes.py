"""The recipe of a run on the TurtleBot3 testbed: everything that determines it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

from sim.campaigns import Campaign, Options
from sim.middleware.geometry import Pose2D
from sim.testbed import Recipe, from_json
from sim.turtlebot3.arena import Arena

# Options of earlier releases, and their only value now.
_WITHDRAWN = {"debug_topics": False, "cameras": False}

ARENA, RELATION = 4, 5  # branches of the seed


@dataclass(frozen=True, slots=True)
class Conditions:
    """Changes of the testbed itself, because a scenario can change messages only."""

    obstacle: bool = False  # a real cylinder, on no map, at the place of the block's fake object
    speed: float = 1.0  # share of its maximal speed that the robot may drive and turn at
    pedestrian: bool = False  # a person walks to and fro, across that place


@dataclass(frozen=True, slots=True)
class FakeObject:
    """The fake object: a cylinder that does not exist."""

    x: float  # [m]
    y: float  # [m]
    radius: float  # [m]


@dataclass(frozen=True, slots=True)
class Block:
    """Values that all runs of a block share, in the map frame."""

    arena: Arena
    start: Pose2D
    goals: tuple[Pose2D, ...]
    fake_object: FakeObject


@dataclass(frozen=True, slots=True)
class Session:
    """Conditions that are constant within a session, and differ between sessions."""

    index: int
    lidar_bias_m: float  # of /scan
    lidar_noise_m: float  # standard deviation, of both LiDARs
    friction: float  # of the floor, relative to the robot's model
    mass: float  # of the robot, relative to its model
    latency_ms: float  # of every node that processes messages, at least
    lidar_tom_bias_m: float  # of /scan_tom
    lidar_dropouts: float  # share of the rays without a return, of both LiDARs
    latency_jitter_ms: float  # mean of the delay added to the latency
    processor_load: float  # share of the time in which callbacks have to wait
    wheel_left: float  # radius, relative to the model
    wheel_right: float
    gyro_bias_rad_s: float  # about the vertical axis
    gyro_scale: float
    map_errors: float  # share of the cells of walls, and beside them, that are wrong
    start_sd_m: float  # error of the start pose that localisation gets, along each axis
    start_sd_rad: float


@dataclass(frozen=True, slots=True)
class TurtleBot3Recipe(Recipe):
    """Everything that determines a run; poses and the fake object are in the map frame."""

    conditions: Conditions
    session: Session
    arena: Arena
    start: Pose2D
    goals: tuple[Pose2D, ...]
    fake_object: FakeObject
    timeout_s: float
    options: Options

    @property
    def world(self) -> str:
        """Identifier of the world."""
        mirrored = "-mirrored" if self.options.relation == "mirrored" else ""
        return f"{self.arena.id}{mirrored}"

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON values.

        It holds Nav2's parameters, the relation and a pedestrian only if they are set, and options
        that earlier releases had, so their recipes stay valid.
        """
        usual = asdict(Options())
        document = Recipe.to_dict(self)
        options = document["options"] = {**document["options"], **_WITHDRAWN}
        for name in ("nav2_params", "relation"):
            if options[name] == usual[name]:
                del options[name]
        if not self.conditions.pedestrian:
            del document["conditions"]["pedestrian"]
        return document

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the recipe from the result of ``to_dict``."""
        former = _WITHDRAWN.items()
        named = document["options"].items()
        options = {name: value for name, value in named if (name, value) not in former}
        recipe: Self = from_json(cls, {**document, "options": options})
        return recipe

    def campaign(self) -> Campaign:
        """Return the run's campaign, as far as the draws of its block depend on it."""
        return Campaign(
            self.seed, len(self.goals), self.storage, self.timeout_s, options=self.options,
            session=self.session.index, noise_per_run=bool(self.noise),
        )  # fmt: skip
