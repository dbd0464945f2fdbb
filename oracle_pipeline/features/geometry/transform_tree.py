"""The tree of frames from static transforms, and where sensors are mounted in it."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from oracle_pipeline.features.engine.plugin import Request, Series
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.robots.roles import STATIC_TRANSFORMS

_TILTED = 0.99  # determinant of a rotation's upper left block below which a scan plane is tilted


class SensorMount(NamedTuple):
    """The pose of a sensor on the robot; None if its plane is tilted."""

    root: str  # of the tree of frames
    pose: PlanarPose | None


class TransformTree:
    """The tree of frames from static transforms."""

    def __init__(self, topics: Mapping[str, Series]) -> None:
        self._parents: dict[str, tuple[str, Floats]] = {
            child: (parent, matrix)
            for series in topics.values()
            for transforms in series.values
            for parent, child, matrix in transforms
        }

    def mount(self, frame: str) -> SensorMount:
        """Return the root of a frame's tree, and the frame's pose in it."""
        pose = np.eye(4)
        for _ in self._parents:  # a loop in a broken tree ends too
            if frame not in self._parents:
                break
            frame, transform = self._parents[frame]
            pose = transform @ pose
        block = pose[:2, :2]
        determinant = float(np.linalg.det(block))
        if abs(determinant) < _TILTED:
            return SensorMount(frame, None)
        translation, rotation = (
            np.array(complex(*column), dtype=np.complex128) for column in (pose[:2, 3], block[:, 0])
        )
        return SensorMount(frame, PlanarPose(translation, rotation, mirrored=determinant < 0.0))


def keep_transforms(message: Any) -> list[tuple[str, str, Floats]]:
    """Return parent, child and pose, as a 4 by 4 matrix, of each transform of a ``TFMessage``."""
    return [
        (each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/"), _matrix(each.transform))
        for each in message.transforms
    ]


STATIC_FRAMES = Request(keep_transforms, role=STATIC_TRANSFORMS, dtype=object, optional=True)


def _matrix(transform: Any) -> Floats:
    shift, q = transform.translation, transform.rotation
    length = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if length == 0.0:
        raise ValueError("a transform has no rotation")
    x, y, z, w = q.x / length, q.y / length, q.z / length, q.w / length
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    return np.array([
        [xx - yy - zz + ww, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w), shift.x],
        [2.0 * (x * y + z * w), -xx + yy - zz + ww, 2.0 * (y * z - x * w), shift.y],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -xx - yy + zz + ww, shift.z],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip
