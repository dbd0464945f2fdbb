"""Motion capture, as the package ``motion_capture_tracking`` publishes it."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats
from sim.crazyflie.recipes import CrazyflieSession
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.middleware.tf import planar_transform, transforms_template

NAME, FRAME = "cf231", "world"
POSES_NS = 10 * MILLISECOND
POSES = "motion_capture_tracking_interfaces/msg/NamedPoseArray"

_NamedPose = message_class("motion_capture_tracking_interfaces/msg/NamedPose")
_NamedPoseArray = message_class(POSES)
_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")


def pose_message(position: Iterable[float], quaternion: Iterable[float]) -> Any:
    """Return ``geometry_msgs/msg/Pose``, from a quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return _Pose(_Point(*position), _Quaternion(x, y, z, w))


class MotionCapture(Node):
    """``/poses`` and ``/tf`` of the Crazyflie, 100 times a second.

    Parameters
    ----------
    domain, rng
        As for `Node`.
    measure
        Returns exact position and orientation.
    session
        Its errors.
    """

    def __init__(
        self,
        domain: Domain,
        measure: Callable[[], tuple[Floats, Floats]],
        session: CrazyflieSession,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(domain, "/motion_capture_tracking", endpoints="PE", rng=rng)
        self._measure = measure
        self._sd = np.repeat([session.tracking_m, session.tracking_rad / 2.0], (3, 4))
        self._lost = session.lost
        self._poses = self.create_publisher(POSES, "/poses", qos.SENSOR_DATA)
        self._tf = self.create_publisher("tf2_msgs/msg/TFMessage", "/tf", qos.TF)
        self._transform = transforms_template([planar_transform(0, FRAME, NAME, Pose2D())])
        here = pose_message((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        self._array = Template(_poses(0, here), POSES, (*STAMP, "poses.0.pose"))
        self.create_timer(POSES_NS, self._publish)

    def _publish(self) -> None:
        noise, seen = self._sd * self.rng.standard_normal(7), self.rng.random()
        if seen < self._lost:
            return
        position, quaternion = self._measure()
        position, quaternion = position + noise[:3], quaternion + noise[3:]
        quaternion /= np.sqrt((quaternion**2).sum())
        w, *turn = quaternion.tolist()
        numbers = [*position.tolist(), *turn, w]
        stamp = self.stamp
        message = _poses(self.now_ns, pose_message(position.tolist(), quaternion.tolist()))
        self._poses.publish(message, self._array.data(*stamp, numbers))
        self._tf.publish_serialized(self._transform.data(*stamp, numbers))


def _poses(time_ns: int, pose: object) -> object:
    return _NamedPoseArray(header(time_ns, FRAME), [_NamedPose(NAME, pose)])
