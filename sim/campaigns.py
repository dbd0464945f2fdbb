"""Settings that all runs of a campaign share, on any testbed."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Self, cast, get_args

from oracle_pipeline.bags.errors import OracleError

Storage = Literal["mcap", "sqlite3"]
Wiring = Literal["additive", "replace", "absent"]
OdometrySource = Literal["world", "encoder"]  # gazebo_ros_diff_drive's two
# Tuned to the narrow gaps of the hexagon, or as Nav2 ships them. Drawn: stock in a house, where it
# leaves the robot enough room, and tuned elsewhere; a recipe holds the result.
Navigation = Literal["tuned", "stock", "drawn"]
# Drawn: block 0 is in the hexagon, 1 in a house, 2 in a random arena, 3 in the hexagon, ...
ArenaChoice = Literal["drawn", "hexagon", "house", "random"]
# How a run is related to the runs of its block (see `relations`). A relation changes the task, but
# not how well it should be done, so runs can be compared without a reference.
Relation = Literal["same", "mirrored", "reordered", "shifted"]

DEFAULT_SEED = 20260101


class RecipeError(OracleError):
    """A setting of a campaign is invalid."""


@dataclass(frozen=True, slots=True)
class Options:
    """Settings that a launch file and ``ros2 bag record`` would have; the defaults are Humble's.

    A testbed ignores settings that do not apply to it.
    """

    # How the mode's node is connected. Additive: its output is one more source of
    # obstacles, as in the thesis. Replace: the collision monitor receives it instead of the LiDAR
    # that it mutates. Absent: there is no such node.
    wiring: Wiring = "additive"
    odometry_source: OdometrySource = "world"
    arena: ArenaChoice = "drawn"
    nav2: Navigation = "tuned"
    relation: Relation = "same"
    # Changed values of Nav2's parameters, by full name: see ``sim.nav2.parameters``.
    nav2_params: Mapping[str, float] = field(default_factory=dict, hash=False)
    hidden_topics: bool = False  # feedback and status of actions
    receive_stamps: bool = False  # bag stamps are the recorder's wall clock, not simulated time


@dataclass(frozen=True, slots=True)
class Campaign:
    """Settings that all runs of a campaign share."""

    seed: int = DEFAULT_SEED
    goals_per_run: int = 8  # 1 is the thesis's protocol
    storage: Storage = "mcap"
    timeout_s: float = 600.0  # of simulated time; the duration of all runs of air traffic
    options: Options = field(default_factory=Options)
    sessions: int | None = None  # number of sessions that take turns; None: one per block
    session: int | None = None  # of all blocks
    noise_per_run: bool = False  # draw noise of sensors and latencies per run; else per block

    @classmethod
    def from_environment(cls) -> Self:
        """Return the default campaign, with the settings in the environment variables.

        These are ``ORACLE_GOALS_PER_RUN``, ``ORACLE_ARENA``, ``ORACLE_NAV2``, ``ORACLE_SESSIONS``
        and ``ORACLE_NOISE_PER_RUN``.
        """
        return cls(
            goals_per_run=_count("ORACLE_GOALS_PER_RUN") or cls().goals_per_run,
            options=Options(
                arena=cast("ArenaChoice", _choice("ORACLE_ARENA", ArenaChoice, "drawn")),
                nav2=cast("Navigation", _choice("ORACLE_NAV2", Navigation, "tuned")),
            ),
            sessions=_count("ORACLE_SESSIONS"),
            noise_per_run=is_set("ORACLE_NOISE_PER_RUN"),
        )

    def session_of(self, block: int) -> int:
        """Return the session in which the runs of a block are made."""
        if self.session is not None:
            return self.session
        return block if self.sessions is None else block % self.sessions


def _count(variable: str) -> int | None:
    text = os.environ.get(variable)
    if text is None:
        return None
    if not text.isdecimal() or int(text) < 1:
        raise RecipeError(f"{variable} is {text!r}; give a whole number from 1 on.")
    return int(text)


def is_set(variable: str) -> bool:
    """Return whether an environment variable is 1; an unset one counts as 0.

    Raises
    ------
    RecipeError
        It is something else.
    """
    text = os.environ.get(variable, "0")
    if text not in ("0", "1"):
        raise RecipeError(f"{variable} is {text!r}; give 0 or 1.")
    return text == "1"


def _choice(variable: str, of: object, default: str) -> str:
    text = os.environ.get(variable, default)
    choices = get_args(of)
    if text not in choices:
        raise RecipeError(f"{variable} is {text!r}; give one of {', '.join(choices)}.")
    return text
