"""What all runs of a campaign have in common, whatever their testbed."""

import os
from dataclasses import dataclass
from typing import Literal, Self, cast, get_args

from oracle_pipeline.bags.errors import OracleError

Storage = Literal["mcap", "sqlite3"]
Wiring = Literal["additive", "replace", "absent"]
OdometrySource = Literal["world", "encoder"]  # gazebo_ros_diff_drive's two
# Drawn: block 0 is in the hexagon, 1 in a house, 2 in a random arena, 3 in the hexagon, ...
ArenaChoice = Literal["drawn", "hexagon", "house", "random"]

DEFAULT_SEED = 20260101


class RecipeError(OracleError):
    """A campaign was asked for something that cannot be drawn."""


@dataclass(frozen=True, slots=True)
class Options:
    """What a launch file and ``ros2 bag record`` would be told; by default as on Humble.

    Those that a testbed has no use for change nothing there.
    """

    # How the mode's node stands in the system. Additive: what it publishes is one more source of
    # obstacles, as in the thesis. Replace: the collision monitor hears it instead of the LiDAR
    # that it mutates. Absent: there is no such node.
    wiring: Wiring = "additive"
    odometry_source: OdometrySource = "world"
    arena: ArenaChoice = "drawn"
    cameras: bool = False  # images and points of the depth camera, 15 MB a second
    debug_topics: bool = False  # /evaluation and /marker, 20 MB a second while driving
    hidden_topics: bool = False  # feedback and status of actions
    receive_stamps: bool = False  # bag stamps are the recorder's wall clock, not simulated time


@dataclass(frozen=True, slots=True)
class Campaign:
    """What all runs of a campaign have in common."""

    seed: int = DEFAULT_SEED
    goals_per_run: int = 8  # 1 is the thesis's protocol
    storage: Storage = "mcap"
    timeout_s: float = 600.0  # of simulated time; air traffic has no goals and always takes it all
    options: Options = Options()

    @classmethod
    def from_environment(cls) -> Self:
        """Return the default campaign, with ``ORACLE_GOALS_PER_RUN`` goals in ``ORACLE_ARENA``."""
        text = os.environ.get("ORACLE_GOALS_PER_RUN", "8")
        if not text.isdecimal() or int(text) < 1:
            raise RecipeError(f"ORACLE_GOALS_PER_RUN is {text!r}; give a whole number from 1 on.")
        arena = os.environ.get("ORACLE_ARENA", "drawn")
        if arena not in get_args(ArenaChoice):
            choices = ", ".join(get_args(ArenaChoice))
            raise RecipeError(f"ORACLE_ARENA is {arena!r}; give one of {choices}.")
        return cls(goals_per_run=int(text), options=Options(arena=cast("ArenaChoice", arena)))
