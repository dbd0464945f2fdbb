"""The yardstick of the testbed: a fixed MuJoCo loop with which its speed is compared.

The loop simulates a two-wheeled robot in a world of walls and pillars, and casts the rays of its
two LiDARs. That is the minimum work of any simulator of this robot, so its time shows how fast the
machine is. The loop is frozen: it uses nothing of ``sim``. So a faster testbed has a better ratio,
and figures of different versions can be compared. A test compares digests of the model and of the
loop's results.
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
    """Time and result of one pass of the loop."""

    seconds: float  # of the machine's clock
    processor_s: float  # of this process alone, without other load on the machine
    position: NDArray[np.float64]  # (3,) of the robot at the end [m]
    ranges: NDArray[np.float64]  # (360,) of the last scan [m], -1 without a return


@cache
def _model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(MODEL))


def run(simulated_s: float) -> Loop:
    """Simulate in steps of 5 ms with contacts; both LiDARs scan 5 times a second."""
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
