"""Metamorphic relations: changes of a task that should not change how well it is done.

The correct path of a run is unknown. But in a mirrored world it is the mirrored path, in reverse
order the legs are as long, and from a nearby start the path is about the same. ``oracle kinds``
compares such runs.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim.campaigns import Relation
from sim.middleware.geometry import Pose2D
from sim.turtlebot3.map import WORLD_IN_MAP
from sim.turtlebot3.recipes import Block

SHIFT_M = (0.15, 0.3)  # from the start: least and most
_DRAWS = 50  # of a nearby start


def related(block: Block, relation: Relation, rng: np.random.Generator) -> Iterator[Block]:
    """Yield candidates for the related block, best first; not all of them can be driven.

    Parameters
    ----------
    block
        The original.
    relation
        - ``mirrored``: the block reflected in the x axis of the world.
        - ``reordered``: from the last goal back to the start, so that the legs are the same.
        - ``shifted``: from a start `SHIFT_M` away, turned as before.
        - ``same``: the block itself.
    rng
        Draws the shifted start.
    """
    match relation:
        case "mirrored":
            yield _mirrored(block)
        case "reordered":
            start, *goals = reversed([block.start, *block.goals])
            yield replace(block, start=start, goals=tuple(goals))
        case "shifted":
            for _ in range(_DRAWS):
                away_m, towards = rng.uniform(*SHIFT_M), rng.uniform(-math.pi, math.pi)
                x = block.start.x + away_m * math.cos(towards)
                y = block.start.y + away_m * math.sin(towards)
                yield replace(block, start=replace(block.start, x=x, y=y))
        case "same":
            yield block


def _mirrored(block: Block) -> Block:
    there = _across(Pose2D(block.fake_object.x, block.fake_object.y))
    return Block(
        block.arena.mirrored(),
        _across(block.start),
        tuple(map(_across, block.goals)),
        replace(block.fake_object, x=there.x, y=there.y),
    )


def _across(pose: Pose2D) -> Pose2D:
    """Return a pose in the map frame, reflected in the x axis of the world."""
    seen = WORLD_IN_MAP.inverse().compose(pose)
    return WORLD_IN_MAP.compose(Pose2D(seen.x, 0.0 - seen.y, 0.0 - seen.yaw))
