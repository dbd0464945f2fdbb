"""The collision monitor: limits or stops a velocity before it reaches the wheels.

For every command it counts the sensor points inside each polygon around the robot and stops the
robot or slows it down, as Nav2's collision monitor does on Humble.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.template import STAMP, Template
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.endpoints import Publisher
from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import stamp_ns
from sim.middleware.tf import TransformBuffer, TransformError
from sim.nav2.footprint import POLYGON, polygon_message
from sim.nav2.laser import scan_points
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.messages import TWIST, twist_bytes, twist_message

Points = NDArray[np.float64]  # shape (n, 2): x, y [m]


BASE_FRAME = "base_footprint"
ODOM_FRAME = "odom"
SOURCE_TIMEOUT_NS = 5 * SECOND
STOP_PUB_TIMEOUT_NS = 2 * SECOND
_RANGE_STEP_RAD = math.radians(1.0)
_SPARE_M = 1e-6  # margin around a polygon's box for rounding errors
_Four = tuple[float, float, float, float]
_NO_POINTS: Points = np.empty((0, 2))


class Polygon(NamedTuple):
    """A zone around the robot, and how much of a command is sent if points are in it."""

    name: str
    topic: str  # on which it is published
    vertices: Points  # in ``BASE_FRAME``
    share: float  # 0: the robot is stopped
    max_points: int = 3  # it acts on more points than this


POLYGON_STOP = Polygon(
    "PolygonStop",
    "/polygon_stop",
    np.array([(0.3, 0.3), (0.3, -0.3), (0.0, -0.3), (0.0, 0.3)]),
    share=0.0,
)
POLYGON_SLOW = Polygon(
    "PolygonSlow",
    "/polygon_slowdown",
    np.array([(0.4, 0.3), (0.4, -0.3), (-0.25, -0.3), (-0.25, 0.3)]),
    share=0.3,
)
# As in Humble's parameters: also beside and behind the robot, so that it acts near every wall.
POLYGON_SLOW_STOCK = POLYGON_SLOW._replace(
    vertices=0.4 * np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
)
POLYGONS = (POLYGON_STOP, POLYGON_SLOW)
STOCK_POLYGONS = (POLYGON_STOP, POLYGON_SLOW_STOCK)


class PointSource(NamedTuple):
    """A topic of obstacles: laser scans, or single ranges (``sensor_msgs/msg/Range``)."""

    topic: str
    msgtype: Literal["sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Range"]


SOURCES = (
    PointSource("/scan", "sensor_msgs/msg/LaserScan"),
    PointSource("/scan_tom", "sensor_msgs/msg/LaserScan"),
    PointSource("/scan_fakeobject", "sensor_msgs/msg/LaserScan"),
    PointSource("/range_ella", "sensor_msgs/msg/Range"),
)


class _Cloud:
    """The points of all sources in the odometry frame.

    Of a source, it holds the latest message whose transform to that frame is known. Nav2 waits for
    the transform at a message's stamp; here the previous message is used until then.
    """

    def __init__(self, transforms: TransformBuffer, sources: Sequence[PointSource]) -> None:
        self._transforms = transforms
        self._waiting: dict[PointSource, Any] = {}  # messages whose transform is not yet known
        self._points = dict.fromkeys(sources, _NO_POINTS)
        self._until_ns: dict[PointSource, int] = {}  # when points become too old

    def receive(self, source: PointSource, message: Any) -> None:
        """Store a new message; the transform of the previous one is known by now."""
        if source in self._waiting:
            self._place(source)
        self._waiting[source] = message

    def points(self, now_ns: int) -> tuple[Points, ...]:
        """Return the points of each source; none if they are too old."""
        for source in list(self._waiting):
            self._place(source)
        for source, until_ns in self._until_ns.items():
            if now_ns > until_ns:
                self._points[source] = _NO_POINTS
        return tuple(self._points.values())

    def _place(self, source: PointSource) -> None:
        message = self._waiting[source]
        time_ns = stamp_ns(message.header.stamp)
        try:
            sensor = self._transforms.lookup(ODOM_FRAME, message.header.frame_id, time_ns)
        except TransformError:
            return
        self._points[source] = _POINTS_OF[source.msgtype](message, sensor)
        self._until_ns[source] = time_ns + SOURCE_TIMEOUT_NS
        del self._waiting[source]


class CollisionMonitor(LifecycleNode):
    """Answers every command on ``/cmd_vel_raw`` with one on ``/cmd_vel``.

    A source without messages for five seconds has no points. The strictest polygon decides. A robot
    that was stopped for two seconds gets no more commands.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    transforms
        What its transform listener fills. The robot's motion since a scan is taken out with the
        newest odometry transform.
    polygons
        In the order of their tests; none is tested after one that stops the robot.
    sources
        Sources of points.
    """

    def __init__(
        self,
        domain: Domain,
        transforms: TransformBuffer,
        *,
        polygons: Sequence[Polygon] = POLYGONS,
        sources: Sequence[PointSource] = SOURCES,
        latency_ns: int = 0,
    ) -> None:
        super().__init__(domain, "/collision_monitor", latency_ns=latency_ns)
        self._transforms = transforms
        self._polygons = polygons
        self._sources = sources
        self._cloud = _Cloud(self._transforms, sources)
        self._box = _box(polygons)
        self._action = ""  # polygon that acts
        self._halted_ns: int | None = None  # since when commands are zero
        self.commands = self.commands_altered = 0  # to move; of these, slowed down or stopped

    def on_configure(self) -> None:
        """Open the topics."""
        self._publisher = self.create_publisher(TWIST, "/cmd_vel", qos.RELIABLE)
        # The shapes stay as they are in the robot's frame: only their stamps change.
        self._shapes: list[tuple[Publisher, Template]] = [
            (
                self.create_publisher(POLYGON, polygon.topic),
                Template(polygon_message(0, BASE_FRAME, polygon.vertices), POLYGON, STAMP),
            )
            for polygon in self._polygons
        ]
        for source in self._sources:
            self.create_subscription(
                source.msgtype,
                source.topic,
                functools.partial(self._cloud.receive, source),
                qos.SENSOR_DATA,
            )

    def on_activate(self) -> None:
        """Publish the polygons, and begin to answer commands."""
        self._publish_polygons()
        self.create_subscription(TWIST, "/cmd_vel_raw", self._on_command, qos.RELIABLE)

    def _on_command(self, twist: Any) -> None:
        command = (twist.linear.x, twist.angular.z)
        (linear, angular), polygon = self._judge(command, self._points())
        if command != (0.0, 0.0):
            self.commands += 1
            self.commands_altered += bool(polygon)
        if polygon != self._action:
            self.info(
                f"Robot acts on {polygon}" if polygon else "Robot to continue normal operation"
            )
            self._action = polygon
        self._publish(linear, angular)
        self._publish_polygons()

    def _points(self) -> Points:
        """Return the points that any polygon may hold, in the current base frame."""
        seen = self._cloud.points(self.now_ns)
        try:
            odom = self._transforms.lookup(BASE_FRAME, ODOM_FRAME)
        except TransformError:
            return _NO_POINTS
        pose = (odom.x, odom.y, math.cos(odom.yaw), math.sin(odom.yaw))
        return _nearby(seen, pose, self._box)

    def _judge(
        self, command: tuple[float, float], points: Points
    ) -> tuple[tuple[float, float], str]:
        """Return the velocity to send and the name of the polygon behind it, if any."""
        request, cause = command, ""
        if not len(points):  # as a rule
            return request, cause
        for polygon in self._polygons:
            if points_inside(polygon.vertices, points) <= polygon.max_points:
                continue
            if polygon.share == 0.0:
                return (0.0, 0.0), polygon.name
            slower = (command[0] * polygon.share, command[1] * polygon.share)
            if math.hypot(*slower) < math.hypot(*request):
                request, cause = slower, polygon.name
        return request, cause

    def _publish(self, linear: float, angular: float) -> None:
        if linear == 0.0 and angular == 0.0:
            if self._halted_ns is None:
                self._halted_ns = self.now_ns
            elif self.now_ns - self._halted_ns > STOP_PUB_TIMEOUT_NS:
                return
        else:
            self._halted_ns = None
        self._publisher.publish(twist_message(linear, angular), twist_bytes(linear, angular))

    def _publish_polygons(self) -> None:
        for publisher, shape in self._shapes:
            publisher.publish_serialized(shape.data(*self.stamp))


def range_points(message: Any, sensor: Pose2D) -> Points:
    """Return the arc of a ``Range`` from a sensor's pose, with at least one point per degree."""
    if not message.min_range <= message.range <= message.max_range:
        return np.empty((0, 2))
    return sensor.apply(message.range * _arc(message.field_of_view))


@functools.lru_cache(maxsize=16)
def _arc(field_of_view: float) -> Points:
    """Return unit vectors in a field of view, one for each degree, shape (n, 2)."""
    half = field_of_view / 2.0
    angles = np.append(np.arange(-half, half, _RANGE_STEP_RAD), half)
    return np.column_stack([np.cos(angles), np.sin(angles)])


_POINTS_OF = {"sensor_msgs/msg/LaserScan": scan_points, "sensor_msgs/msg/Range": range_points}


def _box(polygons: Sequence[Polygon]) -> _Four:
    """Return left, bottom, right and top of a box around polygons [m]."""
    vertices = np.concatenate([polygon.vertices for polygon in polygons])
    left, bottom = (vertices.min(axis=0) - _SPARE_M).tolist()
    right, top = (vertices.max(axis=0) + _SPARE_M).tolist()
    return left, bottom, right, top


@jit
def _nearby(parts: tuple[Points, ...], pose: _Four, box: _Four) -> Points:
    """Move points as `Pose2D.apply` does, and return those inside a box, shape (n, 2) [m]."""
    (x, y, c, s), (left, bottom, right, top) = pose, box
    most = 0
    for points in parts:
        most += len(points)
    moved = np.empty((most, 2))
    count = 0
    for points in parts:
        for k in range(len(points)):
            moved[count, 0] = x + c * points[k, 0] - s * points[k, 1]
            moved[count, 1] = y + s * points[k, 0] + c * points[k, 1]
            count += left <= moved[count, 0] <= right and bottom <= moved[count, 1] <= top
    return moved[:count]


@jit
def points_inside(vertices: Points, points: Points) -> int:
    """Count the points inside a polygon (even-odd rule).

    Parameters
    ----------
    vertices, points : ndarray of shape (n, 2)
        In the same frame [m].
    """
    count = 0
    left, right = vertices[:, 0].min() - _SPARE_M, vertices[:, 0].max() + _SPARE_M
    low, high = vertices[:, 1].min() - _SPARE_M, vertices[:, 1].max() + _SPARE_M
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if not (left <= x <= right and low <= y <= high):  # most of them
            continue
        inside = False
        j = len(vertices) - 1
        for i in range(len(vertices)):
            if (vertices[i, 1] <= y) == (vertices[j, 1] > y):
                share = (y - vertices[i, 1]) / (vertices[j, 1] - vertices[i, 1])
                if x < vertices[i, 0] + share * (vertices[j, 0] - vertices[i, 0]):
                    inside = not inside
            j = i
        count += inside
    return count
