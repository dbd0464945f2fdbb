"""Paths as arrays, as ``nav_msgs/msg/Path``, and straight as CDR.

A path has up to some hundred poses and goes out at 20 Hz, so ``path_bytes`` lays it out as an
array instead of building and serialising one object a pose.
"""

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.types import message_class
from sim.jit import jit
from sim.middleware.stamps import header
from sim.nav2.messages import pose_stamped, pose_yaw

PATH = "nav_msgs/msg/Path"
Poses = NDArray[np.float64]  # shape (n, 3): x [m], y [m], yaw [rad]

_Path = message_class(PATH)

_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


def path_message(time_ns: int, frame: str, poses: Poses) -> Any:
    """Return the message of a path; every pose carries the path's header."""
    stamped = [pose_stamped(time_ns, frame, *pose) for pose in poses.tolist()]
    return _Path(header(time_ns, frame), stamped)


def path_poses(path: Any) -> Poses:
    """Return the poses of a path message."""
    poses = [(p.pose.position.x, p.pose.position.y, pose_yaw(p.pose)) for p in path.poses]
    return np.array(poses, dtype=np.float64).reshape(-1, 3)


def path_bytes(time_ns: int, frame: str, poses: Poses) -> bytes:
    """Return what ``serialize(path_message(...))`` returns, much sooner."""
    name = frame.encode() + b"\0"
    stamp = struct.pack("<iII", *divmod(time_ns, 1_000_000_000), len(name)) + name
    front = stamp.ljust(-4 * (-len(stamp) // 4), b"\0") + struct.pack("<I", len(poses))
    if not len(poses):
        return _CDR_LITTLE_ENDIAN + front
    # Doubles are aligned to 8 bytes: the first pose starts where the front ends, the others on a
    # multiple of 8.
    first = (front + stamp).ljust(-8 * (-(len(front) + len(stamp)) // 8), b"\0")
    padded = stamp.ljust(-8 * (-len(stamp) // 8), b"\0")
    record = np.frombuffer(padded + bytes(56), np.float64)
    return _CDR_LITTLE_ENDIAN + first + _records(record, poses).tobytes()[len(padded) :]


@jit
def _records(record: NDArray[np.float64], poses: Poses) -> NDArray[np.float64]:
    """Return a row a pose: header and zeros of ``record``, with x, y and quaternion filled in."""
    rows = np.empty((len(poses), len(record)))
    end = len(record)
    for i in range(len(poses)):
        rows[i] = record
        rows[i, end - 7] = poses[i, 0]
        rows[i, end - 6] = poses[i, 1]
        rows[i, end - 2] = math.sin(poses[i, 2] / 2.0)
        rows[i, end - 1] = math.cos(poses[i, 2] / 2.0)
    return rows


def length_ahead(poses: Poses, x: float, y: float) -> float:
    """Return the length of a path from its pose closest to a point on [m]."""
    closest = int(np.argmin(np.hypot(poses[:, 0] - x, poses[:, 1] - y)))
    steps = np.diff(poses[closest:, :2], axis=0)
    return float(np.sum(np.hypot(steps[:, 0], steps[:, 1])))
