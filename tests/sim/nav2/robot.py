"""An ideal robot without physics, for tests of the nodes that drive one."""

import math

from oracle_pipeline.bags.types import message_class
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.geometry import Pose2D, yaw_quaternion
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.middleware.tf import TransformBroadcaster, TransformListener, planar_transform
from sim.nav2.messages import TWIST, twist_message

Odometry = message_class("nav_msgs/msg/Odometry")
Point = message_class("geometry_msgs/msg/Point")
Pose = message_class("geometry_msgs/msg/Pose")
PoseWithCovariance = message_class("geometry_msgs/msg/PoseWithCovariance")
Quaternion = message_class("geometry_msgs/msg/Quaternion")
TwistWithCovariance = message_class("geometry_msgs/msg/TwistWithCovariance")

PERIOD_NS = 34 * MILLISECOND


class IdealRobot(Node):
    """Follows commands exactly, publishes ``/odom`` and ``/tf``; map and odom coincide."""

    def __init__(self, topic, pose=None):
        self.executor = Executor()
        super().__init__(Domain(self.executor), "/robot")
        self.pose = pose or Pose2D()
        self.is_stuck = False
        self.twists = []  # (time, linear, angular) of every received command
        self._command = (0.0, 0.0)
        self.create_subscription(TWIST, topic, self._on_command)
        self._odometry = self.create_publisher("nav_msgs/msg/Odometry", "/odom")
        self._tf = TransformBroadcaster(self)
        fixed = TransformBroadcaster(self, static=True)
        fixed.send(
            [
                planar_transform(0, "map", "odom", Pose2D()),
                planar_transform(0, "base_footprint", "base_link", Pose2D()),
            ]
        )
        self.buffer = TransformListener(self.domain, "000000000000").buffer
        self.create_timer(PERIOD_NS, self._move, phase_ns=0)
        self.run(0.001)

    def run(self, seconds):
        """Let time pass."""
        self.executor.run_until(self.now_ns + round(seconds * SECOND))

    def _on_command(self, twist):
        self._command = (twist.linear.x, twist.angular.z)
        self.twists.append((self.now_ns, *self._command))

    def _move(self):
        v, w = (0.0, 0.0) if self.is_stuck else self._command
        dt = PERIOD_NS / SECOND
        self.pose = self.pose.compose(
            Pose2D(v * dt * math.cos(w * dt / 2), v * dt * math.sin(w * dt / 2), w * dt)
        )
        self._tf.send([planar_transform(self.now_ns, "odom", "base_footprint", self.pose)])
        pose = Pose(
            Point(self.pose.x, self.pose.y, 0.0), Quaternion(*yaw_quaternion(self.pose.yaw))
        )
        self._odometry.publish(
            Odometry(
                header(self.now_ns, "odom"),
                "base_footprint",
                PoseWithCovariance(pose, None),
                TwistWithCovariance(twist_message(v, w), None),
            )
        )
