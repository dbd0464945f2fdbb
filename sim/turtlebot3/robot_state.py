"""The robot state publisher: transforms of the robot's parts."""

import math
from typing import Any

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, stamp_ns
from sim.middleware.tf import TransformBroadcaster, transforms_template
from sim.turtlebot3 import frames
from sim.turtlebot3.clock import CLOCK_NS

_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_String = message_class("std_msgs/msg/String")
_Transform = message_class("geometry_msgs/msg/Transform")
_TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

WHEEL_TF_NS = 50 * MILLISECOND

_WHEEL_ROTATIONS = [mount.quaternion() for mount in frames.WHEELS]


class RobotStatePublisher(Node):
    """The robot's frames: the fixed ones once, the wheels' at up to 20 Hz."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/robot_state_publisher")
        description = self.create_publisher(
            "std_msgs/msg/String", "/robot_description", qos.LATCHED
        )
        self._tf = TransformBroadcaster(self)
        static = TransformBroadcaster(self, static=True)
        self._last_ns = -WHEEL_TF_NS
        self.create_subscription("sensor_msgs/msg/JointState", "/joint_states", self._on_joints)
        self._tf_bytes = transforms_template(
            [_transform(0, mount, mount.quaternion()) for mount in frames.WHEELS]
        )
        description.publish(_String(frames.robot_description()))
        static.send([_transform(self.now_ns, mount, mount.quaternion()) for mount in frames.STATIC])

    def _on_joints(self, state: Any) -> None:
        now_ns = stamp_ns(state.header.stamp)
        # The original also compares with its own clock, which /clock advances ten times a second:
        # hence 19.4 Hz on Humble, not the 14.7 Hz of every second joint state.
        clock_ns = now_ns - now_ns % CLOCK_NS
        if now_ns < min(clock_ns, self._last_ns) + WHEEL_TF_NS:
            return
        self._last_ns = now_ns
        stamp = divmod(now_ns, SECOND)
        turned = [
            _turned(rotation, angle)
            for rotation, angle in zip(_WHEEL_ROTATIONS, state.position.tolist(), strict=True)
        ]
        wheels = list(zip(frames.WHEELS, turned, strict=True))
        self._tf.send(
            [_transform(now_ns, mount, rotation) for mount, rotation in wheels],
            self._tf_bytes.data(
                *(part for mount, turn in wheels for part in (*stamp, (*mount.xyz, *turn)))
            ),
        )


def _turned(
    quaternion: tuple[float, float, float, float], angle: float
) -> tuple[float, float, float, float]:
    """Return a rotation (x, y, z, w) followed by a turn about its own z axis."""
    x, y, z, w = quaternion
    s, c = math.sin(angle / 2.0), math.cos(angle / 2.0)
    return x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s


def _transform(
    time_ns: int, mount: frames.Mount, quaternion: tuple[float, float, float, float]
) -> Any:
    return _TransformStamped(
        header(time_ns, mount.parent),
        mount.child,
        _Transform(_Vector3(*mount.xyz), _Quaternion(*quaternion)),
    )
