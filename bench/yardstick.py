"""The yardstick of the testbed: a fixed MuJoCo loop that speed is measured against.

A robot on two wheels stands in a world of walls and pillars; the loop simulates it and casts its
two LiDARs' rays. This is the least that a simulator of the testbed's robot would have to do, and
how long it takes says how fast the machine is. It is frozen: nothing here comes from ``sim``, so
that a faster testbed has a better ratio, and figures of different versions compare. A test holds
the digest of the model and of this loop's results.
"""

import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

MODEL = Path(__file__).with_name("yardstick.xml")
STEP_S = 0.005
SCAN_S = 0.2
RAYS = 360
LIDARS = 2
RANGE_MAX_M = 20.0
_START = (-2.0, -0.5, 0.010)  # of the robot [m]
_LIDAR_HEIGHT_M = 0.15
_SEEN = np.array([1, 0, 0, 0, 0, 0], np.uint8)  # geom groups: the world, not the robot


class Loop(NamedTuple):
    """What one pass over the loop took and came to."""

    seconds: float  # of the machine's clock
    processor_s: float  # of this process alone: what else the machine does does not count
    position: NDArray[np.float64]  # (3,) of the robot at the end [m]
    ranges: NDArray[np.float64]  # (360,) of the last scan [m], -1 where there is nothing


@cache
def _model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(MODEL))


def run(simulated_s: float) -> Loop:
    """Simulate for so long, in steps of 5 ms with contacts, and scan twice 5 times a second."""
    model = _model()
    data = mujoco.MjData(model)
    data.qpos[:3] = _START
    angles = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(RAYS)]).ravel()
    geoms, ranges = np.empty(RAYS, np.int32), np.empty(RAYS)
    steps = round(SCAN_S / STEP_S)
    mujoco.mj_forward(model, data)
    wall, processor = time.perf_counter(), time.process_time()
    for _ in range(round(simulated_s / SCAN_S)):
        mujoco.mj_step(model, data, steps)
        origin = np.array([data.qpos[0], data.qpos[1], _LIDAR_HEIGHT_M])
        for _ in range(LIDARS):
            mujoco.mj_multiRay(
                model, data, origin, directions, _SEEN, 1, -1, geoms, ranges, None, RAYS,
                RANGE_MAX_M,
            )  # fmt: skip
    return Loop(
        time.perf_counter() - wall, time.process_time() - processor, data.qpos[:3].copy(), ranges
    )
