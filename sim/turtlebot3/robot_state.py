"""The robot state publisher: transforms of the robot's parts."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats
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

_Rotation = tuple[float, float, float, float]  # x, y, z, w

WHEEL_TF_NS = 50 * MILLISECOND

_WHEEL_OFFSETS = [_Vector3(*mount.xyz) for mount in frames.WHEELS]
_WHEEL_ROTATIONS = np.array([mount.quaternion() for mount in frames.WHEELS])  # x, y, z, w


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
        wheels = [_transform(0, mount, mount.quaternion()) for mount in frames.WHEELS]
        self._wheel_row = transforms_template(wheels).rows(1)
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
        left, right = state.position.tolist()
        rotations = _fill_in(self._wheel_row, now_ns, left, right, _WHEEL_ROTATIONS)
        stamped = header(now_ns, frames.WHEELS[0].parent)
        transforms = [
            _TransformStamped(stamped, mount.child, _Transform(offset, _Quaternion(*rotation)))
            for mount, offset, rotation in zip(
                frames.WHEELS, _WHEEL_OFFSETS, rotations, strict=True
            )
        ]
        self._tf.send(transforms, self._wheel_row.tobytes())


@jit
def _fill_in(
    row: NDArray[np.void], now_ns: int, left: float, right: float, rotations: Floats
) -> tuple[_Rotation, _Rotation]:
    """Write stamps and rotations of the wheels' transforms; return the rotations."""
    first, second = _turned(rotations[0], left), _turned(rotations[1], right)
    wheels = row[0]
    wheels["transforms.0.header.stamp.sec"] = now_ns // SECOND
    wheels["transforms.1.header.stamp.sec"] = now_ns // SECOND
    wheels["transforms.0.header.stamp.nanosec"] = now_ns % SECOND
    wheels["transforms.1.header.stamp.nanosec"] = now_ns % SECOND
    for i in range(4):
        wheels["transforms.0.transform"][3 + i] = first[i]
        wheels["transforms.1.transform"][3 + i] = second[i]
    return first, second


@jit
def _turned(rotation: Floats, angle: float) -> _Rotation:
    """Return a rotation (x, y, z, w) followed by a turn about its own z axis."""
    x, y, z, w = rotation
    s, c = math.sin(angle / 2.0), math.cos(angle / 2.0)
    return x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s


def _transform(time_ns: int, mount: frames.Mount, rotation: _Rotation) -> Any:
    return _TransformStamped(
        header(time_ns, mount.parent),
        mount.child,
        _Transform(_Vector3(*mount.xyz), _Quaternion(*rotation)),
    )
