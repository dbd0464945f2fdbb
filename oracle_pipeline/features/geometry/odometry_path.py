"""The path of the robot's frames in the frame of its odometry."""

from typing import Any

import numpy as np

from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s, poses_of
from oracle_pipeline.features.engine.plugin import Request, Series
from oracle_pipeline.features.geometry.planar_pose import PlanarPose, PosePath
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.features.geometry.transform_tree import SensorMount, TransformTree
from oracle_pipeline.robots.roles import ODOMETRY


class OdometryPath:
    """Poses of the robot's frames in the odometry frame, from ``nav_msgs/msg/Odometry``."""

    def __init__(self, series: Series, tree: TransformTree) -> None:
        stamps, children, *pose = zip(*series.values, strict=True)
        order = np.argsort(stamps, kind="stable")
        self._path = PosePath(*(np.array(column)[order] for column in (stamps, *pose)))
        self._base = tree.mount(children[0])

    def base(self, stamps_s: Floats) -> PlanarPose:
        """Return the poses of odometry's child frame, one for each stamp."""
        return self._path.at(stamps_s)

    def at(self, mount: SensorMount, stamps_s: Floats) -> PlanarPose:
        """Return the poses of a sensor, one for each stamp."""
        base = self.base(stamps_s)
        if self._base.root == mount.root and self._base.pose is not None:
            base = base.compose(self._base.pose.inverse())
        return base if mount.pose is None else base.compose(mount.pose)


def keep_odometry(messages: Any) -> tuple[Any, ...]:
    """Return the values for `OdometryPath` from ``nav_msgs/msg/Odometry``."""
    frames = frame_names(messages.child_frame_id)
    return header_stamps_s(messages), frames, *poses_of(messages.pose.pose)


ODOMETRY_POSES = Request(keep_odometry, role=ODOMETRY, dtype=object, many=True)
