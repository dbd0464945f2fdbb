"""Blocks of a reference: recordings that share a start, or a drawn world, count as one.

Such recordings resemble each other, so only blocks have a vote. Run directories tell their start,
and the number of a block counts within its seed. Another recording starts where its localisation,
or else its odometry, says first; those of another day have other batteries, people and light.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from oracle_pipeline.opened_run import OpenedRun
from oracle_pipeline.robots.first_messages import FirstMessages
from oracle_pipeline.robots.robot import Robot
from oracle_pipeline.robots.roles import ODOMETRY, POSE

NEAR_M, NEAR_RAD = 0.15, 0.15  # between two starts that are the same; localisation has noise
PER_SEED = 1_000_000  # blocks; those of a reference's further seeds have higher numbers
UNKNOWN_SEED = -1
_DAY_NS = 86_400 * 10**9


class Start(NamedTuple):
    """The pose at which a recording starts, in the map or the odometry's frame."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]
    day: int  # since the epoch; 0 for a simulation

    def is_near(self, other: "Start") -> bool:
        """Return whether two recordings start at one place on one day."""
        turn = math.remainder(self.yaw - other.yaw, math.tau)
        apart_m = math.hypot(self.x - other.x, self.y - other.y)
        return self.day == other.day and apart_m <= NEAR_M and abs(turn) <= NEAR_RAD


class Origin(NamedTuple):
    """Where a recording comes from."""

    seed: int  # of a run directory, else `UNKNOWN_SEED`
    block: int = -1
    world: str = ""
    start: Start | None = None  # None: unknown

    @property
    def has_manifest(self) -> bool:
        """Whether the recording is a run directory."""
        return self.seed != UNKNOWN_SEED

    def shares(self, other: "Origin") -> bool:
        """Return whether two recordings are of one block."""
        if self.has_manifest and other.has_manifest:
            if self.world != other.world:
                return False
            is_one = (self.seed, self.block) == (other.seed, other.block)
            is_there = self.start is not None and self.start == other.start
            # Or drawn: then the world's name ends with a seed.
            return is_one or is_there or self.world.rpartition("-")[2].strip("0").isdigit()
        return (
            self.start is not None and other.start is not None and self.start.is_near(other.start)
        )


def origin_of(run: OpenedRun, robot: Robot, *, starts: bool) -> Origin:
    """Return the origin of a recording, with the start of a bag only if `starts`: it is read."""
    if (manifest := run.manifest) is None:
        return Origin(UNKNOWN_SEED, start=_start(robot) if starts else None)
    pose = manifest.start
    start = Start(pose.x, pose.y, pose.yaw, 0)
    known = start if any(start) else None  # a system that does not drive starts at zero
    return Origin(manifest.seed, manifest.block, manifest.world, known)


def blocks(origins: Sequence[Origin]) -> list[int]:
    """Return the block of each recording: numbers of run directories, below 0 for others.

    Examples
    --------
    >>> here, there = Start(1.0, 0.0, 0.0, 0), Start(2.0, 0.0, 0.0, 0)
    >>> blocks([Origin(7, 3, "a-1", here), Origin(8, 3, "b-1", there), Origin(-1, start=here)])
    [3, 1000003, 3]
    """
    seeds = list(dict.fromkeys(each.seed for each in origins if each.has_manifest))
    found: list[int] = []
    for number, origin in enumerate(origins):
        alike = (b for b, other in zip(found, origins, strict=False) if origin.shares(other))
        own = -1 - number
        if origin.has_manifest:
            own = origin.block + PER_SEED * seeds.index(origin.seed)
        found.append(next(alike, own))
    return found


def _start(robot: Robot) -> Start | None:
    """Return the start of a bag; None without poses, and for odometry that starts at zero."""
    topics = [(role, name) for role in (POSE, ODOMETRY) for name in robot.roles.found[role].topics]
    first = FirstMessages(robot.bag.renamed({name: name for _, name in topics}))
    day = robot.bag.start_ns // _DAY_NS
    for role, name in topics:
        if (pose := first.pose(name)) is not None:
            start, zero = Start(*pose, day), Start(0.0, 0.0, 0.0, day)
            return None if role == ODOMETRY and start.is_near(zero) else start
    return None
