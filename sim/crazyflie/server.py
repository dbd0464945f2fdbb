"""Crazyswarm2's server: the topics of a Crazyflie over its radio.

It hands on setpoints and poses of motion capture to the firmware, and publishes what this logs:
the default topics of Crazyswarm2, the log group ``controller`` and the motors as custom topics, and
the inertial unit and the battery as other bridges do.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.crazyflie.firmware import LOG, Firmware
from sim.crazyflie.tracking import FRAME, NAME, pose_message
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header

SERVER = "/crazyflie_server"
POSE_NS, LOG_NS, STATUS_NS = 20 * MILLISECOND, 10 * MILLISECOND, SECOND
CAN_FLY, IS_FLYING, IS_TUMBLED = 8, 16, 32  # crazyflie_interfaces/msg/Status.supervisor_info
LOW_V = 3.2  # of a battery that the firmware reports as low
_LOW_POWER, _DISCHARGING, _LIPO = 3, 2, 3
_RSSI = (38, 46)  # of a crazyradio in the same room

_BATTERY = "sensor_msgs/msg/BatteryState"
_IMU = "sensor_msgs/msg/Imu"
_LOG = "crazyflie_interfaces/msg/LogDataGeneric"
_ODOMETRY = "nav_msgs/msg/Odometry"
_POSE = "geometry_msgs/msg/PoseStamped"
_STATUS = "crazyflie_interfaces/msg/Status"

_BatteryState = message_class(_BATTERY)
_Imu = message_class(_IMU)
_LogDataGeneric = message_class(_LOG)
_Odometry = message_class(_ODOMETRY)
_PoseStamped = message_class(_POSE)
_PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
_Status = message_class(_STATUS)
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
        super().__init__(domain, SERVER, rng=rng, latency_ns=latency_ns)
        self._firmware = firmware
        self._volts = volts
        self._poses = 0  # received in this period
        self._status = self.create_publisher(_STATUS, f"/{NAME}/status")
        self._battery = self.create_publisher(_BATTERY, f"/{NAME}/battery")
        for topic, msgtype, period_ns, prototype, fields, values in self._logs():
            publisher = self.create_publisher(msgtype, f"/{NAME}/{topic}")
            template = Template(prototype, msgtype, (*STAMP, *fields))
            self._log_every(period_ns, publisher.publish_serialized, template, values)
        self.create_subscription(
            "motion_capture_tracking_interfaces/msg/NamedPoseArray", "/poses", self._on_poses,
            qos.SENSOR_DATA,
        )  # fmt: skip
        self.create_subscription(
            "crazyflie_interfaces/msg/Position", f"/{NAME}/cmd_position", self._on_position,
            qos.SYSTEM_SUBSCRIPTION,
        )  # fmt: skip
        self.create_subscription(
            "crazyflie_interfaces/msg/FullState", f"/{NAME}/cmd_full_state", self._on_full_state,
            qos.SYSTEM_SUBSCRIPTION,
        )  # fmt: skip
        self.create_timer(STATUS_NS, self._report)

    def _logs(
        self,
    ) -> list[tuple[str, str, int, Any, tuple[str, ...], Callable[[], tuple[Any, ...]]]]:
        """Return topic, type, period, prototype, fields and values of what is published often."""
        firmware = self._firmware
        zero, upright = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        here, still = pose_message(zero, upright), _Vector3(0.0, 0.0, 0.0)
        world, frame = header(0, FRAME), header(0, NAME)
        unknown = np.zeros(36)
        odometry = _Odometry(
            world, NAME, _PoseWithCovariance(here, unknown),
            _TwistWithCovariance(_Twist(still, still), unknown),
        )  # fmt: skip
        imu = _Imu(frame, here.orientation, np.zeros(9), still, np.zeros(9), still, np.zeros(9))
        return [
            ("pose", _POSE, POSE_NS, _PoseStamped(world, here), ("pose",),
             lambda: (self._pose(),)),
            ("odom", _ODOMETRY, POSE_NS, odometry, ("pose.pose", "twist.twist"),
             lambda: (self._pose(), [*firmware.velocity.tolist(), 0.0, 0.0, 0.0])),
            ("imu", _IMU, LOG_NS, imu, ("orientation", "angular_velocity", "linear_acceleration"),
             lambda: (self._pose()[3:], firmware.inertial[:3], firmware.inertial[3:])),
            ("controller", _LOG, LOG_NS, _log(frame, len(LOG)), ("timestamp", "values"),
             lambda: (self.now_ns // MILLISECOND, firmware.log.tolist())),
            ("motors", _LOG, POSE_NS, _log(frame, 4), ("timestamp", "values"),
             lambda: (self.now_ns // MILLISECOND, (65535.0 * firmware.duty).round().tolist())),
        ]  # fmt: skip

    def _log_every(
        self, period_ns: int, publish: Callable[[bytes], None], template: Template,
        values: Callable[[], tuple[Any, ...]],
    ) -> None:  # fmt: skip
        self.create_timer(
            period_ns, lambda: publish(template.data(*divmod(self.now_ns, SECOND), *values()))
        )

    def _pose(self) -> list[float]:
        """Return the estimate as in a message: position, then the quaternion x, y, z, w."""
        w, x, y, z = self._firmware.quaternion.tolist()
        return [*self._firmware.position.tolist(), x, y, z, w]

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
        at, turn = message.pose.position, message.pose.orientation
        yaw = np.arctan2(2.0 * (turn.w * turn.z + turn.x * turn.y),
                         1.0 - 2.0 * (turn.y**2 + turn.z**2))  # fmt: skip
        self._firmware.set_point(at.x, at.y, at.z, float(np.degrees(yaw)))

    def _report(self) -> None:
        """Publish the state of the Crazyflie, its radio and its battery."""
        firmware, volts = self._firmware, self._volts()
        state = CAN_FLY | IS_FLYING * firmware.is_flying | IS_TUMBLED * firmware.is_tumbled
        now, packets, self._poses = header(self.now_ns, NAME), self._poses, 0
        self._status.publish(
            _Status(now, state, volts, _LOW_POWER * (volts < LOW_V),
                    int(self.rng.integers(*_RSSI)), packets, packets, 0, 0, 0)
        )  # fmt: skip
        nan = float("nan")
        self._battery.publish(
            _BatteryState(now, volts, nan, nan, nan, nan, 0.25, nan, _DISCHARGING, 0, _LIPO, True,
                          np.array([volts], np.float32), np.zeros(0, np.float32), "", "")
        )  # fmt: skip


def _log(frame: Any, variables: int) -> Any:
    return _LogDataGeneric(frame, 0, np.zeros(variables, np.float32))
