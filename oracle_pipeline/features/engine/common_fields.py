"""Parts that many message types have: stamps, frames and poses, of many messages at once."""

import math
from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]


def header_stamps_s(messages: Any) -> Floats:
    """Return the headers' stamps [s]."""
    stamps = messages.header.stamp
    seconds: Floats = stamps.sec + 1e-9 * stamps.nanosec
    return seconds


def frame_names(texts: Iterable[str]) -> list[str]:
    """Return the names of frames without the leading slash of old drivers."""
    return [text.lstrip("/") for text in texts]


def poses_of(poses: Any) -> tuple[Floats, Floats, Floats]:
    """Return x [m], y [m] and yaw [rad] of ``geometry_msgs/msg/Pose``s."""
    position, q = poses.position, poses.orientation
    yaw = arc_tangents(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return position.x, position.y, yaw


def arc_tangents(y: Floats, x: Floats) -> Floats:
    """Return the C library's ``atan2``; numpy's differs between processors."""
    return np.array(list(map(math.atan2, y.tolist(), x.tolist())))
