"""Draws the places, the object and the robot of a block from the campaign's seed.

Run i of every mode belongs to block i.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from oracle_pipeline.bags.manifest import Pose
from sim.arm.cell import GRASP_Z, POST_M, downward, over, solve
from sim.arm.recipes import ArmRecipe, ArmSession
from sim.arm.trajectories import touches
from sim.campaigns import Campaign
from sim.seeds import BLOCK, SESSION, generator
from sim.testbed import Mode

_X_M, _Y_M = (0.35, 0.6), (0.15, 0.4)  # of places; on both sides of the post
_YAW = (-math.pi / 2.0, math.pi / 2.0)
_POST_X_M, _POST_Y_M = (0.45, 0.6), (-0.03, 0.03)
# Usual friction of the joints, and half of the spread between robots [N m].
_FRICTION = (8.0, 8.0, 8.0, 2.0, 2.0, 2.0)


def draw(mode: Mode, run: int, campaign: Campaign, given: Mapping[str, Any]) -> ArmRecipe:
    """Return the recipe of one run of a campaign; the arguments are those of `Testbed.draw`."""
    rng = generator(campaign.seed, BLOCK, run)
    post = Pose(rng.uniform(*_POST_X_M), rng.uniform(*_POST_Y_M), 0.0)
    spots = [_draw_spot(rng, (-1.0) ** (n + 1), post) for n in range(campaign.goals_per_run + 1)]
    return ArmRecipe(
        **mode.recipe_fields(run, campaign, {}, given),
        session=_draw_session(campaign.seed, campaign.session_of(run)),
        start=spots[0],
        places=tuple(spots[1:]),
        obstacle=post,
        timeout_s=campaign.timeout_s,
    )


def _draw_spot(rng: np.random.Generator, side: float, post: Pose) -> Pose:
    """Draw a place that the gripper reaches, on the right (-1) or left (1) of the post."""
    box = np.array([[[post.x, post.y, POST_M[2]], POST_M]])
    while True:
        x, y, yaw = rng.uniform(*_X_M), side * rng.uniform(*_Y_M), rng.uniform(*_YAW)
        joints = solve(downward(x, y, GRASP_Z, yaw), over(x, y))
        if joints is not None and not touches(joints, box):
            return Pose(x, y, yaw)


def _draw_session(seed: int, index: int) -> ArmSession:
    """Draw the conditions of a session; see docs/explanation/arm.md for the ranges."""
    rng = generator(seed, SESSION, index)
    return ArmSession(
        index=index, mass=rng.uniform(0.15, 0.35), friction=rng.uniform(0.8, 1.1),
        gains=rng.uniform(0.95, 1.05),
        joint_friction=tuple((rng.uniform(0.8, 1.2, 6) * _FRICTION).tolist()),
        encoder=tuple(rng.uniform(-3e-4, 3e-4, 6).tolist()), latency_ms=rng.uniform(1.0, 5.0),
        camera=tuple(rng.uniform(-2e-3, 2e-3, 2).tolist()), camera_m=rng.uniform(2e-4, 1e-3),
        force_n=rng.uniform(0.5, 1.5), torque_nm=rng.uniform(0.01, 0.03),
    )  # fmt: skip
