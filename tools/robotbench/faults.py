"""Faults that robots may have, put into recordings of real ones.

The robots did not react to them, so what they change is what sensors say.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

#: By the end of a file's name: the messages of a topic, in order of time. Changed in place.
Tables: TypeAlias = Mapping[str, pd.DataFrame]
Positions: TypeAlias = NDArray[np.float32]  # of joints, shape (n, n_joints)

BEFORE = 1 / 3  # of a part is as it was
SLIP = 1.3  # wheels turn so many times as fast as the robot moves
JUMP_M = 22.0
JOINT = 10  # the right elbow of a humanoid
OFFSET_RAD = 0.1
LATE = 5  # messages, at 30 Hz
_PLACE = ("position.x", "position.y")
_SPEED = ("linear.x", "linear.y")


def frozen(topic: str) -> Callable[[Tables], None]:
    """Return the fault that a topic repeats its last numbers; stamps and counters go on."""

    def change(tables: Tables) -> None:
        table = tables[topic]
        first = int(BEFORE * len(table))
        numbers = [c for c in table.columns if c != "Time" and not c.startswith("header.")]
        table.loc[table.index[first:], numbers] = table.loc[table.index[first], numbers].to_numpy()

    return change


def slip(tables: Tables) -> None:
    """Let odometry tell more than was driven: wheels slip."""
    table = tables["odom"]
    later = table.index[int(BEFORE * len(table)) :]
    for column in table.columns[table.columns.str.endswith(_PLACE)]:
        start = table.loc[later[0], column]
        table.loc[later, column] = start + SLIP * (table.loc[later, column] - start)
    for column in table.columns[table.columns.str.endswith(_SPEED)]:
        table.loc[later, column] *= SLIP


def jump(tables: Tables) -> None:
    """Move the place that another source than odometry tells, as satellites may."""
    table = tables["robot_pose"]
    table.loc[table.index[int(BEFORE * len(table)) :], "position.x"] += JUMP_M


FAULTS: Mapping[str, Callable[[Tables], None]] = {
    "imu_frozen": frozen("data"),
    "wheel_slip": slip,
    "place_jump": jump,
    "odometry_frozen": frozen("odom"),
}


def encoder_offset(positions: Positions) -> Positions:
    """Return positions of which one encoder is off."""
    positions[:, JOINT] += OFFSET_RAD
    return positions


def late(positions: Positions) -> Positions:
    """Return positions that come late."""
    return np.concatenate([positions[:1].repeat(LATE, axis=0), positions[:-LATE]])


def stuck(positions: Positions) -> Positions:
    """Return positions of which one stands still."""
    first = int(BEFORE * len(positions))
    positions[first:, JOINT] = positions[first, JOINT]
    return positions


OF_JOINTS: Mapping[str, Callable[[Positions], Positions]] = {
    "encoder_offset": encoder_offset,
    "late_joints": late,
    "stuck_joint": stuck,
}
