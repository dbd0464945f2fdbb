"""Paths as arrays, as ``nav_msgs/msg/Path``, and as CDR bytes.

A path has up to some hundred poses and goes out at 20 Hz, so ``path_bytes`` lays it out as an
array instead of building and serialising an object for each pose.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.types import message_class
from sim.jit import jit
from sim.middleware.stamps import header
from sim.nav2.cdr_words import CDR_LITTLE_ENDIAN, header_words, put
from sim.nav2.messages import pose_stamped, pose_yaw

PATH = "nav_msgs/msg/Path"
Poses = NDArray[np.float64]  # shape (n, 3): x [m], y [m], yaw [rad]

_Path = message_class(PATH)


def path_message(time_ns: int, frame: str, poses: Poses) -> Any:
    """Return the message of a path; every pose carries the path's header."""
    return _Path(header(time_ns, frame), _StampedPoses(time_ns, frame, poses))


def path_poses(path: Any) -> Poses:
    """Return the poses of a path message."""
    if isinstance(path.poses, _StampedPoses):
        return path.poses.planar()
    poses = [(p.pose.position.x, p.pose.position.y, pose_yaw(p.pose)) for p in path.poses]
    return np.array(poses, dtype=np.float64).reshape(-1, 3)


class _StampedPoses(Sequence[Any]):
    """The poses of a path message, each of which becomes an object when it is read.

    Servers and clients of this process take paths as arrays, so most poses never do.
    """

    def __init__(self, time_ns: int, frame: str, poses: Poses) -> None:
        self._time_ns = time_ns
        self._frame = frame
        self._poses = poses.copy()

    def __len__(self) -> int:
        return len(self._poses)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        return pose_stamped(self._time_ns, self._frame, *self._poses[index].tolist())

    def planar(self) -> Poses:
        """Return the poses as an array."""
        return _through_quaternions(self._poses)


@jit
def _through_quaternions(poses: Poses) -> Poses:
    """Return poses with each yaw as it comes back from a message: `pose_yaw`."""
    received = poses.copy()
    for i in range(len(poses)):
        z, w = math.sin(poses[i, 2] / 2.0), math.cos(poses[i, 2] / 2.0)
        received[i, 2] = math.atan2(2.0 * (w * z + 0.0), 1.0 - 2.0 * (z * z))
    return received


def path_bytes(time_ns: int, frame: str, poses: Poses) -> bytes:
    """Return the bytes of ``serialize(path_message(...))``, in less time."""
    words = _path_words(*divmod(time_ns, 1_000_000_000), _header(frame), poses)
    return CDR_LITTLE_ENDIAN + words.tobytes()


@functools.cache
def _header(frame: str) -> NDArray[np.uint32]:
    return header_words(0, frame)


@jit
def _path_words(
    seconds: int, nanoseconds: int, header: NDArray[np.uint32], poses: Poses
) -> NDArray[np.uint32]:
    """Return the message; every pose carries the path's header."""
    words = np.zeros(2 * (len(header) // 2 + 1 + len(poses) * (len(header) // 2 + 8)), np.uint32)
    doubles = words.view(np.float64)
    at = put(words, 0, header)
    words[0], words[1] = seconds, nanoseconds
    words[at] = len(poses)
    at += 1
    for i in range(len(poses)):
        words[at + 2 : at + len(header)] = header[2:]
        words[at], words[at + 1] = seconds, nanoseconds
        at += len(header)
        at += at % 2
        double = at // 2
        doubles[double] = poses[i, 0]
        doubles[double + 1] = poses[i, 1]
        doubles[double + 5] = math.sin(poses[i, 2] / 2.0)
        doubles[double + 6] = math.cos(poses[i, 2] / 2.0)
        at += 14
    return words[:at]


def length_ahead(poses: Poses, x: float, y: float) -> float:
    """Return the length of a path from its pose closest to a point on [m]."""
    closest = int(np.argmin(np.hypot(poses[:, 0] - x, poses[:, 1] - y)))
    steps = np.diff(poses[closest:, :2], axis=0)
    return float(np.sum(np.hypot(steps[:, 0], steps[:, 1])))
