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

from oracle_pipeline.bags.cdr import ENCAPSULATION, aligned
from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.types import message_class, serialize
from sim.arrays import Floats
from sim.middleware.geometry import pose_yaw
from sim.middleware.stamps import header
from sim.nav2.messages import pose_stamped

PATH = "nav_msgs/msg/Path"
Poses = NDArray[np.float64]  # shape (n, 3): x [m], y [m], yaw [rad]

_Path = message_class(PATH)


def path_message(time_ns: int, frame: str, poses: Poses) -> Any:
    """Return the message of a path; every pose carries the path's header."""
    return _Path(header(time_ns, frame), _StampedPoses(time_ns, frame, poses))


def path_poses(path: Any) -> Poses:
    """Return the poses of a path message."""
    poses = sent_poses(path)
    return _through_quaternions(poses) if isinstance(path.poses, _StampedPoses) else poses


def sent_poses(path: Any) -> Poses:
    """Return the poses of a path message that is sent on: they give the same bytes."""
    if isinstance(path.poses, _StampedPoses):
        return path.poses.sent
    poses = [(p.pose.position.x, p.pose.position.y, pose_yaw(p.pose)) for p in path.poses]
    return np.array(poses, dtype=np.float64).reshape(-1, 3)


class _StampedPoses(Sequence[Any]):
    """The poses of a path message, each of which becomes an object when it is read.

    Servers and clients of this process take paths as arrays, so most poses never do.
    """

    def __init__(self, time_ns: int, frame: str, poses: Poses) -> None:
        self._time_ns = time_ns
        self._frame = frame
        self.sent = poses.copy()

    def __len__(self) -> int:
        return len(self.sent)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        return pose_stamped(self._time_ns, self._frame, *self.sent[index].tolist())


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
    stamped = _header(frame).copy()
    stamped[:2] = divmod(time_ns, 1_000_000_000)
    return _path_words(stamped, poses).tobytes()


@functools.cache
def _header(frame: str) -> NDArray[np.uint32]:
    return _header_words(0, frame)


def _header_words(time_ns: int, frame: str) -> NDArray[np.uint32]:
    """Return a header as words of four bytes, as whatever comes next is aligned."""
    data = serialize(header(time_ns, frame), "std_msgs/msg/Header")[len(ENCAPSULATION) :]
    return np.frombuffer(data.ljust(aligned(len(data), 4), b"\0"), np.uint32)


_ENCAPSULATION = np.frombuffer(ENCAPSULATION, np.uint32)


@jit
def _path_words(header: NDArray[np.uint32], poses: Poses) -> NDArray[np.uint32]:
    """Return the message with its encapsulation; every pose carries the path's header."""
    begin = 2  # after the encapsulation, where doubles are aligned
    words = np.zeros(begin + len(header) + 2 + len(poses) * (len(header) + 15), np.uint32)
    doubles = words[: len(words) // 2 * 2].view(np.float64)
    words[begin - 1] = _ENCAPSULATION[0]
    at = begin + len(header)
    _copy(header, words, begin)
    words[at] = len(poses)
    at += 1
    yaw = z = w = 0.0
    for i in range(len(poses)):
        _copy(header, words, at)
        at += len(header)
        at += at % 2
        double = at // 2
        doubles[double] = poses[i, 0]
        doubles[double + 1] = poses[i, 1]
        if yaw == 0.0 or poses[i, 2] != yaw:  # a planner's poses share theirs; zeros have signs
            yaw = poses[i, 2]
            z, w = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
        doubles[double + 5], doubles[double + 6] = z, w
        at += 14
    return words[begin - 1 : at]


@jit
def _copy(header: NDArray[np.uint32], words: NDArray[np.uint32], at: int) -> None:
    """Copy word by word: to assign a slice takes numba some seconds more to compile."""
    for i in range(len(header)):
        words[at + i] = header[i]


def length_ahead(poses: Poses, x: float, y: float) -> float:
    """Return the length of a path from its pose closest to a point on [m]."""
    return float(np.sum(_steps_ahead(poses, x, y)))


@jit
def _steps_ahead(poses: Poses, x: float, y: float) -> Floats:
    """Return the distances from pose to pose, from the pose closest to a point on [m]."""
    closest, least = 0, math.inf
    for i in range(len(poses)):
        distance = math.hypot(poses[i, 0] - x, poses[i, 1] - y)
        if distance < least:
            closest, least = i, distance
    steps = np.empty(len(poses) - 1 - closest)
    for i in range(len(steps)):
        here, there = poses[closest + i], poses[closest + i + 1]
        steps[i] = math.hypot(there[0] - here[0], there[1] - here[1])
    return steps
