"""Crazyswarm2's server: the topics of a Crazyflie over its radio.

It forwards setpoints and poses of motion capture to the firmware, and publishes what this logs:
the default topics of Crazyswarm2, the log group ``controller`` and the motors as custom topics, and
the inertial unit and the battery as other bridges do.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.crazyflie.firmware import LOG, Firmware
from sim.crazyflie.tracking import FRAME, NAME, POSES, pose_message
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import pose_yaw
from sim.middleware.node import Node
from sim.middleware.stamps import header

POSE_NS, LOG_NS, STATUS_NS = 20 * MILLISECOND, 10 * MILLISECOND, SECOND
CAN_FLY, IS_FLYING, IS_TUMBLED = 8, 16, 32  # crazyflie_interfaces/msg/Status.supervisor_info
LOW_V = 3.2  # of a battery that the firmware reports as low
_LOW_POWER, _DISCHARGING, _LIPO = 3, 2, 3
_RSSI = (38, 46)  # of a radio in the same room

_BATTERY, _IMU = "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Imu"
_LOG, _STATUS = "crazyflie_interfaces/msg/LogDataGeneric", "crazyflie_interfaces/msg/Status"
_ODOMETRY, _POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"

_FULL_STATE = "crazyflie_interfaces/msg/FullState"
_POSITION = "crazyflie_interfaces/msg/Position"

_BatteryState, _Imu = message_class(_BATTERY), message_class(_IMU)
_LogDataGeneric, _Status = message_class(_LOG), message_class(_STATUS)
_Odometry, _PoseStamped = message_class(_ODOMETRY), message_class(_POSE)
_PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
_Twist = message_class("geometry_msgs/msg/Twist")
_TwistWithCovariance = message_class("geometry_msgs/msg/TwistWithCovariance")
_Vector3 = message_class("geometry_msgs/msg/Vector3")


class CrazyflieServer(Node):
    """The server of one Crazyflie.

    Parameters
    ----------
    domain, rng, latency_ns
        As for `Node`.
    firmware
        Firmware of the Crazyflie.
    volts
        Returns what it measures at its battery.
    """

    def __init__(
        self,
        domain: Domain,
        firmware: Firmware,
        volts: Callable[[], float],
        rng: np.random.Generator,
        latency_ns: int,
    ) -> None:
        super().__init__(
            domain, "/crazyflie_server", endpoints="PE", rng=rng, latency_ns=latency_ns
        )
        self._firmware = firmware
        self._volts = volts
        self._poses = 0  # received in this period
        self._status = self.create_publisher(_STATUS, f"/{NAME}/status")
        self._battery = self.create_publisher(_BATTERY, f"/{NAME}/battery")
        self._create_logs()
        self.create_subscription(POSES, "/poses", self._on_poses, qos.SENSOR_DATA)
        subscribe = partial(self.create_subscription, qos=qos.SYSTEM)
        subscribe(_POSITION, f"/{NAME}/cmd_position", self._on_position)
        subscribe(_FULL_STATE, f"/{NAME}/cmd_full_state", self._on_full_state)
        self.create_timer(STATUS_NS, self._report)

    def _create_logs(self) -> None:
        """Publish what the firmware logs often, each at its period."""
        here, still = pose_message((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), _Vector3(0, 0, 0)
        world, frame, none = header(0, FRAME), header(0, NAME), np.zeros(9)
        pose = _PoseWithCovariance(here, np.zeros(36))
        twist = _TwistWithCovariance(_Twist(still, still), np.zeros(36))
        imu = _Imu(frame, here.orientation, none, still, none, still, none)
        for topic, msgtype, prototype, fields, period_ns, values in (
            ("pose", _POSE, _PoseStamped(world, here), ("pose",), POSE_NS, self._pose),
            ("odom", _ODOMETRY, _Odometry(world, NAME, pose, twist), ("pose.pose", "twist.twist"),
             POSE_NS, self._motion),
            ("imu", _IMU, imu, ("orientation", "angular_velocity", "linear_acceleration"), LOG_NS,
             self._inertial),
            ("controller", _LOG, _log(frame, len(LOG)), ("timestamp", "values"), LOG_NS,
             self._controller),
            ("motors", _LOG, _log(frame, 4), ("timestamp", "values"), POSE_NS, self._motors),
        ):  # fmt: skip
            publish = self.create_publisher(msgtype, f"/{NAME}/{topic}").publish_serialized
            template = Template(prototype, msgtype, (*STAMP, *fields))
            self.create_timer(period_ns, partial(self._send, publish, template, values))

    def _send(
        self, publish: Callable[[bytes], None], template: Template, values: Callable[[], Any]
    ) -> None:
        publish(template.data(*self.stamp, *values()))

    def _pose(self) -> tuple[list[float]]:
        """Return the estimate as in a message: position, then the quaternion x, y, z, w."""
        w, x, y, z = self._firmware.state.quaternion.tolist()
        return ([*self._firmware.state.position.tolist(), x, y, z, w],)

    def _motion(self) -> tuple[list[float], list[float]]:
        return *self._pose(), [*self._firmware.state.velocity.tolist(), 0.0, 0.0, 0.0]

    def _inertial(self) -> tuple[list[float], list[float], list[float]]:
        measured = self._firmware.state.inertial.tolist()
        return self._pose()[0][3:], measured[:3], measured[3:]

    def _controller(self) -> tuple[int, list[float]]:
        return self.now_ns // MILLISECOND, self._firmware.state.log.tolist()

    def _motors(self) -> tuple[int, list[float]]:
        return self.now_ns // MILLISECOND, (65535.0 * self._firmware.duty).round().tolist()

    def _on_poses(self, message: Any) -> None:
        self._poses += 1
        for named in message.poses:
            if named.name == NAME:
                at, turn = named.pose.position, named.pose.orientation
                self._firmware.locate(
                    np.array([at.x, at.y, at.z]), np.array([turn.w, turn.x, turn.y, turn.z])
                )

    def _on_position(self, message: Any) -> None:
        self._firmware.set_point(message.x, message.y, message.z, message.yaw)

    def _on_full_state(self, message: Any) -> None:
        at, yaw = message.pose.position, pose_yaw(message.pose)
        self._firmware.set_point(at.x, at.y, at.z, math.degrees(yaw))

    def _report(self) -> None:
        """Publish the state of the Crazyflie, its radio and its battery."""
        firmware, volts, nan = self._firmware, self._volts(), math.nan
        flies = bool(firmware.duty.any())
        state = CAN_FLY | IS_FLYING * flies | IS_TUMBLED * firmware.is_tumbled
        low, signal = _LOW_POWER * (volts < LOW_V), int(self.rng.integers(*_RSSI))
        now, packets, self._poses = header(self.now_ns, NAME), self._poses, 0
        self._status.publish(_Status(now, state, volts, low, signal, packets, packets, 0, 0, 0))
        cells = np.array([volts], np.float32), np.zeros(0, np.float32)
        self._battery.publish(
            _BatteryState(now, volts, nan, nan, nan, nan, 0.25, nan, _DISCHARGING, 0, _LIPO, True,
                          *cells, "", "")
        )  # fmt: skip


def _log(frame: Any, variables: int) -> Any:
    return _LogDataGeneric(frame, 0, np.zeros(variables, np.float32))
