"""Motion capture, as the package ``motion_capture_tracking`` publishes it, and the clock."""

from collections.abc import Callable
from typing import Any

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.crazyflie.airframe import Floats
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, time_message
from sim.middleware.tf import transforms_template

NAME, FRAME = "cf231", "world"
POSES_NS = 10 * MILLISECOND
_CLOCK_NS = 100 * MILLISECOND
_POSES = "motion_capture_tracking_interfaces/msg/NamedPoseArray"

_Clock = message_class("rosgraph_msgs/msg/Clock")
_NamedPose = message_class("motion_capture_tracking_interfaces/msg/NamedPose")
_NamedPoseArray = message_class(_POSES)
_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Transform = message_class("geometry_msgs/msg/Transform")
_TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
_Vector3 = message_class("geometry_msgs/msg/Vector3")


def pose_message(position: Floats, quaternion: Floats) -> Any:
    """Return ``geometry_msgs/msg/Pose``, from a quaternion w, x, y, z."""
    w, x, y, z = quaternion.tolist()
    return _Pose(_Point(*position.tolist()), _Quaternion(x, y, z, w))


class SimulatorClock(Node):
    """``/clock``."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/simulator")
        clock = self.create_publisher("rosgraph_msgs/msg/Clock", "/clock", qos.CLOCK)
        self.create_timer(_CLOCK_NS, lambda: clock.publish(_Clock(time_message(self.now_ns))))


class MotionCapture(Node):
    """``/poses`` and ``/tf`` of the Crazyflie, 100 times a second.

    Parameters
    ----------
    domain, rng
        As for `Node`.
    measure
        Returns exact position and orientation.
    tracking_m, tracking_rad, lost
        Errors, as in `CrazyflieSession`.
    """

    def __init__(
        self,
        domain: Domain,
        measure: Callable[[], tuple[Floats, Floats]],
        tracking_m: float,
        tracking_rad: float,
        lost: float,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(domain, "/motion_capture_tracking", rng=rng)
        self._measure = measure
        self._sd = np.repeat([tracking_m, tracking_rad / 2.0], (3, 4))
        self._lost = lost
        self._poses = self.create_publisher(_POSES, "/poses", qos.SENSOR_DATA)
        self._tf = self.create_publisher("tf2_msgs/msg/TFMessage", "/tf", qos.TF)
        still = _Transform(_Vector3(0.0, 0.0, 0.0), _Quaternion(0.0, 0.0, 0.0, 1.0))
        self._transform = transforms_template([_TransformStamped(header(0, FRAME), NAME, still)])
        here = pose_message(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        self._array = Template(_poses(0, here), _POSES, (*STAMP, "poses.0.pose"))
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
        stamp = divmod(self.now_ns, SECOND)
        message = _poses(self.now_ns, pose_message(position, quaternion))
        self._poses.publish(message, self._array.data(*stamp, numbers))
        self._tf.publish_serialized(self._transform.data(*stamp, numbers))


def _poses(time_ns: int, pose: object) -> object:
    return _NamedPoseArray(header(time_ns, FRAME), [_NamedPose(NAME, pose)])
